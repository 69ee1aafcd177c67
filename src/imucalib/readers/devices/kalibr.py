"""Kalibr's own CSV, as its bag creator reads it: ns, rad/s, m/s²."""

from __future__ import annotations

from imucalib.readers.devices.catalogue import Device
from imucalib.recording.mapping import FieldMapping

DEVICE = Device(
    "kalibr",
    FieldMapping(
        gyro=("omega_x", "omega_y", "omega_z"),
        acc=("alpha_x", "alpha_y", "alpha_z"),
        time="timestamp",
        acc_unit="m/s2",
        gyro_unit="rad/s",
        time_unit="ns",
    ),
    words=("omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z",),
)
