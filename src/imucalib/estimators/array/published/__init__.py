"""Paper 001 as published: its likelihood, and the chain that draws from it."""
