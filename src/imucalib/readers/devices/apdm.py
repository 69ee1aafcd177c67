"""APDM Opal: HDF5 files of Motion Studio."""

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "apdm",
    FieldMapping(acc_unit="m/s2", gyro_unit="rad/s", temperature_unit="degC", time_unit="us"),
)
