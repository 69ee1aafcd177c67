"""Reports of a bench."""
