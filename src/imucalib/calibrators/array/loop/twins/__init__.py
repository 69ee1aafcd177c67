"""Lags that look alike."""
