"""Calibrations of one sensor against each other: do they differ, what it means, how they drift."""
