"""The report of `imucal imu`."""
