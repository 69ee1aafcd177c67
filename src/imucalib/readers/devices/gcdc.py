"""Gulf Coast Data Concepts: CSV in counts (X16, X2) or in units that the header states (HAM, MRL),
seconds since the start in the header or in the rows."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from imucalib.readers.devices.catalogue import Device, DeviceStart
from imucalib.recording.mapping import FieldMapping
from imucalib.units import canonical

_START = re.compile(r"start_time\s*,\s*(\d{4}-\d{2}-\d{2})\s*,\s*(\d{2}:\d{2}:\d{2})(\.\d+)?", re.I)


#: The line of the sensor's chip, or one a quantity with counts in one of its unit.
_UNITS = re.compile(r"units, (mg|g), (mdps|dps)", re.I)
_SENSITIVITY = re.compile(r";(accel|gyro), *[\d.]+, *(1|1000), *[\d.]+, *(g|dps)\b", re.I)


def _units(text: str) -> dict[str, str]:
    chip = _UNITS.search(text)
    if chip:
        return {"acceleration": canonical(chip[1]), "angular_rate": canonical(chip[2])}
    return {
        "acceleration" if kind.lower() == "accel" else "angular_rate": canonical(
            f"m{unit}" if counts == "1000" else unit
        )
        for kind, counts, unit in _SENSITIVITY.findall(text)
    }


def _start(text: str) -> DeviceStart:
    found, units = _START.search(text), _units(text)
    try:
        whole = datetime.fromisoformat(f"{found[1]}T{found[2]}") if found else None
    except ValueError:
        whole = None
    if found is None or whole is None:
        return DeviceStart(units=units)
    seconds = int(whole.replace(tzinfo=UTC).timestamp())
    part = round(float(found[3] or 0) * 1e9)
    notes = ("the start time has no zone: taken as UTC",)
    return DeviceStart(seconds * 1_000_000_000 + part, notes, units=units)


DEVICE = Device(
    "gcdc",
    FieldMapping(time="1", acc=("2", "3", "4"), time_unit="s"),
    words=("gcdataconcepts",),
    start=_start,
    scales=(1024.0, 2048.0, 16384.0),  # by model and gain; the header names neither,
    source="README of the AerobaticLogger project on GitHub (an IMU-GPS logger)",
)
