"""What a reading owes to when it was taken, and to what the sensor read before it."""
