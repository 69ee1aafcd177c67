"""Comma-separated recordings and tables."""
