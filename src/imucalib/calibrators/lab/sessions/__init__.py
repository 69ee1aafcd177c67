"""Power-ups of one sensor: their tables as one, and what changes between them."""
