"""What a field of a recording means, its clock and its gaps: settled once for all formats."""
