"""Several logs of one board: whether they agree, and what they say together."""
