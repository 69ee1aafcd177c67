"""Structure left beside all that a search took: told, and corrected where that holds out."""
