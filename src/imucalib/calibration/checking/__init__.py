"""Whether a calibration still holds: a short recording against what the calibration predicts."""
