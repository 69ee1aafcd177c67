"""Questions to the posterior: what is missing, what has changed, what to record next."""
