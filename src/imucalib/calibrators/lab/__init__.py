"""An accelerometer on a bench with known angles."""
