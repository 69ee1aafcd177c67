"""A sheet of positions as somebody wrote it."""
