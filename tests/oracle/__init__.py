"""What the documents say, computed a second time with numpy alone."""
