"""What could stand in the place of a name that a search has taken, and is no candidate of it."""
