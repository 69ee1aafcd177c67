"""The report of `imucal check`."""
