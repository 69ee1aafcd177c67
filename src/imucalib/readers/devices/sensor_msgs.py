"""Any driver that publishes ROS messages sensor_msgs/Imu, whose units REP 103 fixes."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device("sensor_msgs", FieldMapping(acc_unit="m/s2", gyro_unit="rad/s"))
