"""The array's likelihood: the motion integrated out in closed form."""
