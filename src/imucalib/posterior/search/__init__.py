"""Sets of components, their evidence, and the search among them."""
