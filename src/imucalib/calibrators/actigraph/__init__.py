"""A worn accelerometer, by gravity alone."""
