"""The closed loop over an array's motion: what it fits, scores and takes in."""
