"""What the array's estimate states: positions with all of their uncertainty."""
