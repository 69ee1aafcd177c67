"""The looks of a document: HTML by templates, SVG, and the terminal."""
