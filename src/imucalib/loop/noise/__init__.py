"""Noise as the loop models it: what neighbours share, hypotheses of its size, doubts about it."""
