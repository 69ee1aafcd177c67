"""`imucal imu`: accelerometer and gyroscope of one IMU, from rests and the turns between them."""
