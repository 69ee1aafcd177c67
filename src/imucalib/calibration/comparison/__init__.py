"""Calibrations of one sensor beside each other: do they differ, what it means, how they drift."""
