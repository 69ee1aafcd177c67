"""Pages of the reference, made from what the program itself says: one module a page."""
