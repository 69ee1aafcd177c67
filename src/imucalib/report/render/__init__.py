"""A document as text, HTML and vector graphics."""
