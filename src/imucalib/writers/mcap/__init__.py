"""MCAP files, written and patched."""
