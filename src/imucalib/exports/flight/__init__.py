"""Forms of flight controllers."""
