"""Xsens: text exports of MT Manager."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "xsens",
    FieldMapping(
        acc=("Acc_X", "Acc_Y", "Acc_Z"),
        gyro=("Gyr_X", "Gyr_Y", "Gyr_Z"),
        acc_unit="m/s2",
        gyro_unit="rad/s",
    ),
    words=("mt manager", "xsens", "xda version"),
)
