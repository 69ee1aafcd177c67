"""ActiGraph: raw CSV exports of ActiLife (its .gt3x files are read by `gt3x`)."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta

from imucalib.errors import UnreadableInput
from imucalib.readers.devices.catalogue import Device, DeviceStart
from imucalib.recording.mapping import FieldMapping

_EPOCH = re.compile(r"epoch period[^0-9]*(\d+):(\d+):(\d+)", re.IGNORECASE)
_START_TIME = re.compile(r"start time[\s,;:]*(\d{1,2}):(\d{2}):(\d{2})", re.IGNORECASE)
_START_DATE = re.compile(r"start date[\s,;:]*(\d+)[/.\-](\d+)[/.\-](\d+)", re.IGNORECASE)
_DATE_FORMAT = re.compile(r"date format\s+(\S+)", re.IGNORECASE)


def _refuse_epochs(text: str, where: str) -> None:
    found = _EPOCH.search(text)
    if found and any(int(part) for part in found.groups()):
        period = ":".join(found.groups())
        raise UnreadableInput(
            f"this ActiGraph file holds activity counts per epoch of {period}, not acceleration",
            where=where,
            remedy="give the .gt3x file itself, or export raw data (RAW CSV) instead of epochs",
        )


def _start(text: str) -> DeviceStart:
    time, date = _START_TIME.search(text), _START_DATE.search(text)
    if not time or not date:
        return DeviceStart()
    a, b, c = (int(g) for g in date.groups())
    stated = _DATE_FORMAT.search(text)
    form = stated.group(1).lower() if stated else ""
    if form.startswith("y") or a > 31:
        year, month, day = a, b, c
    elif form.startswith("d"):
        day, month, year = a, b, c
    else:
        month, day, year = a, b, c
    notes: tuple[str, ...] = ("the start time has no zone: taken as UTC",)
    if month > 12 and day <= 12:
        month, day = day, month
        notes = (*notes, f"the header's date format {form} does not fit its start date: swapped")
    try:
        midnight = datetime(year, month, day, tzinfo=UTC)
    except ValueError:
        return DeviceStart(None, ("the header's start date is not a date: no start time",))
    hours, minutes, seconds = (int(g) for g in time.groups())
    start = midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    return DeviceStart(int(start.timestamp()) * 1_000_000_000, notes)


DEVICE = Device(
    "actigraph",
    FieldMapping(acc=("1", "2", "3"), acc_unit="g"),
    words=("actigraph", "actilife"),
    start=_start,
    refuse=_refuse_epochs,
    sleeps=True,
    source="THLfi/read.gt3x, TAS1H30182785_2019-09-17.csv",
)
