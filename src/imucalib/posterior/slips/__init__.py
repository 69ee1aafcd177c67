"""Slips of hand in a sheet, each a hypothesis."""
