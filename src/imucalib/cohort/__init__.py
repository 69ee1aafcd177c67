"""Many recordings: one entry each, one table of all."""
