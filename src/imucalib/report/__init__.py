"""One document, rendered as text, HTML and JSON."""
