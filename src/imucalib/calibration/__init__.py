"""A calibration as users keep it: numbers, files, application, outcome."""
