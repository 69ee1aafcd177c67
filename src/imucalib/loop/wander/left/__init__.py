"""Structure that is left beside all that a search took, told and not corrected."""
