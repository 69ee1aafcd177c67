"""The search for what a model lacks."""
