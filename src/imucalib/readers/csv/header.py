"""What the lines above a table state about the recording: device, rate, start, kind of values."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

from imucalib.readers.devices.catalogue import UNKNOWN, Device, Start, device_named_in
from imucalib.readers.timebase import start_of
from imucalib.recording.correction import Correction, corrections_of
from imucalib.units import ACCELERATION_UNITS, RATE_UNITS, canonical

_NUMBER = r"(\d+(?:[.,]\d+)?)"
#: A rate of samples says so, or has a unit; that of a filter, a line or a heart is none.
_RATE = re.compile(
    rf"(?:sampl\w*\s*(?:rate|freq\w*)|measurement frequency|update rate)[^0-9\n]{{0,12}}{_NUMBER}"
    rf"\s*(?:hz\b|$|[,;\s])"
    rf"|(?<!baud )(?<!heart )(?<!bit )(?:\brate[^0-9\n]{{0,12}}|(?<!pass )(?<!filter )\bat\s+)"
    rf"{_NUMBER}\s*hz\b",
    re.IGNORECASE | re.MULTILINE,
)
_UNIT = re.compile(
    r"^\W*(acc\w*|beschl\w*|gyr\w*|angular rates?|angular velocity)\s*(?:units?|in|einheit)?\s*"
    r"(?:\bin\b|[:=])\s*[\[(]?([^\s,;\])]+)[\])]?\s*$",
    re.IGNORECASE | re.MULTILINE,
)
_OWN_ROWS = re.compile(
    r"(# imucal recording, rows: (\d+)[^\n]*?)(?:, crc32: ([^\n]*))?$", re.MULTILINE
)
_OWN_MARK = re.compile(r"^# corrected: (.*)$", re.MULTILINE)
_OWN_START = re.compile(r"start_ns\s*[:=]\s*(-?\d+)")


@dataclass(frozen=True)
class Stated:
    """What our own first line says of the table: its rows and, where it has it, the CRC-32 of the
    lines below followed by `line`, its own start."""

    rows: int
    line: str = ""
    crc: int | None = None

    def contradicted(self, rows: int, crc: int) -> list[str]:
        """A sentence for what was found otherwise. crc : of the lines below"""
        if rows != self.rows:
            return [f"the header states {self.rows} rows, {rows} were found"]
        if self.crc is not None and zlib.crc32(self.line.encode(), crc) != self.crc:
            return ["the table is not what was written (CRC-32): numbers in it were changed"]
        return []


@dataclass(frozen=True)
class HeaderFacts:
    """device : whose export it is; rate in Hz; start_ns as in Recording.

    acc_unit, gyro_unit : that a line above the table states, in the usual spelling
    stated : what the file says of its rows, or None; corrections as in Recording
    """

    device: Device = UNKNOWN
    rate: float | None = None
    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    stated: Stated | None = None
    corrections: tuple[Correction, ...] = ()
    acc_unit: str = ""
    gyro_unit: str = ""


def facts_of(preamble: Sequence[str], where: str) -> HeaderFacts:
    """Read the lines above the table. Raises UnreadableInput for what holds no raw data."""
    text = "\n".join(preamble)
    found = _RATE.search(text)
    rate = float((found[1] or found[2]).replace(",", ".")) if found else None
    units = {name[:3].lower(): canonical(unit) for name, unit in _UNIT.findall(text)}
    force, turn = units.get("acc") or units.get("bes", ""), units.get("gyr") or units.get("ang", "")
    own = _OWN_START.search(text)
    notes: list[str] = []
    start = start_of(int(own.group(1)), notes) if own else None
    own_line = _OWN_ROWS.search(text)
    stated = _stated(*own_line.groups()) if own_line else None
    device = device_named_in(text)
    device.refuse(text, where)
    told = device.start(text) if device.start else Start(start)
    marks = corrections_of(_OWN_MARK.findall(text) if stated else ())
    notes += [*told.notes, *map(str, marks)]
    return HeaderFacts(
        device, rate or told.rate or None, told.start_ns, tuple(notes), stated, marks,
        acc_unit=force if force in ACCELERATION_UNITS else "",
        gyro_unit=turn if turn in RATE_UNITS else "",
    )  # fmt: skip


def _stated(line: str, rows: str, crc: str | None) -> Stated:
    try:
        return Stated(int(rows), line, None if crc is None else int(crc, 16))
    except ValueError:  # a damaged sum fits nothing
        return Stated(int(rows), line, -1)
