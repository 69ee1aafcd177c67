"""Simulated sensors, logs and documents that several tests share."""
