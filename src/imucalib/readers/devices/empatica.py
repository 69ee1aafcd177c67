"""Empatica E4: ACC.csv, its start (unix s) and rate (Hz) in the first two rows, values in g/64."""

from __future__ import annotations

from collections.abc import Sequence

from imucalib.readers.devices.catalogue import Device, DeviceStart
from imucalib.readers.fields.timebase import is_absolute
from imucalib.recording.mapping import FieldMapping

_LSB_PER_G = 64.0
_RATES = (1.0, 1024.0)


def _same(line: str) -> float | None:
    """The number that all three cells of a line repeat, or None."""
    cells = [cell.strip() for cell in line.split(",")]
    if len(cells) != 3 or len(set(cells)) != 1:
        return None
    try:
        return float(cells[0])
    except ValueError:
        return None


def _heading(lines: Sequence[str]) -> int:
    if len(lines) < 2:
        return 0
    start, rate = _same(lines[0]), _same(lines[1])
    if start is None or rate is None or "." not in lines[1]:
        return 0
    return 2 if is_absolute(start) and _RATES[0] <= rate <= _RATES[1] else 0


def _start(text: str) -> DeviceStart:
    lines = text.split("\n")
    start, rate = _same(lines[0]), _same(lines[1])
    return DeviceStart(None if start is None else round(start * 1e9), (), rate)


DEVICE = Device(
    "empatica",
    FieldMapping(acc=("1", "2", "3")),
    heading=_heading,
    start=_start,
    scales=(_LSB_PER_G,),
    source="im-ethz/flirt, test/wearable-data/empatica/ACC.csv",
)
