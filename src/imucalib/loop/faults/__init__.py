"""Slips of hand in a bench's sheet, tried before any physics, each with the line to paste."""
