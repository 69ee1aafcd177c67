"""What else would do: beside a name, in its place, and what that leaves open."""
