"""What of the temperature's past a bias may follow."""
