"""Damage to recordings whose every sample is known, and the judge of what a reader makes of it."""
