"""Gulf Coast Data Concepts X16 and X2: CSV in counts, seconds since the start in the header."""

from __future__ import annotations

import re
from datetime import UTC, datetime

from imucalib.readers.devices.catalogue import Device, Start
from imucalib.recording.mapping import FieldMapping

_START = re.compile(r"start_time\s*,\s*(\d{4}-\d{2}-\d{2})\s*,\s*(\d{2}:\d{2}:\d{2})(\.\d+)?", re.I)


def _start(text: str) -> Start:
    found = _START.search(text)
    try:
        whole = datetime.fromisoformat(f"{found[1]}T{found[2]}") if found else None
    except ValueError:
        whole = None
    if found is None or whole is None:
        return Start()
    seconds = int(whole.replace(tzinfo=UTC).timestamp())
    part = round(float(found[3] or 0) * 1e9)
    return Start(seconds * 1_000_000_000 + part, ("the start time has no zone: taken as UTC",))


DEVICE = Device(
    "gcdc",
    FieldMapping(time="1", acc=("2", "3", "4"), time_unit="s"),
    words=("gcdataconcepts",),
    start=_start,
    scales=(1024.0, 2048.0, 16384.0),  # by model and gain; the header names neither
)
