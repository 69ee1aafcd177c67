"""What would tell rivals apart: columns of an effect and of those that do as well, and new data."""
