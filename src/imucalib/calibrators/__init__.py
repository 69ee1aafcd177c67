"""Where the calibrators differ, one folder each."""
