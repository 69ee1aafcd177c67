"""Many devices of one kind: what they share, and what each is by itself."""
