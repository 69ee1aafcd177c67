"""The calibrated array as one instrument: its readings fused into those of a virtual IMU."""
