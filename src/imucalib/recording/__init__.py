"""What a recording is, and how the fields of a file are mapped to it."""
