"""Samplers and their diagnostics."""
