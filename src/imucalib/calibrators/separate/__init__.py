"""What to record next, so that an ambiguity ends: from a finished run's folder to a plan."""
