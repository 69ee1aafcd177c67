"""Reports of an array."""
