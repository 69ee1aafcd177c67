"""The report of `imucal compare`."""
