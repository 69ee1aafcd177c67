"""What each test costs, and which tier it belongs to by that."""
