"""Xsens: text exports of MT Manager."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "xsens",
    FieldMapping(
        acc_unit="m/s2",
        gyro_unit="rad/s",
    ),
    words=("mt manager", "xsens", "xda version", "filter profile:"),
    source="opensim-org/opensim-core, OpenSenseExample/IMUData/MT_012005D6_009-001",
)
