"""Where a recording is still."""
