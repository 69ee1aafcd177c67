"""What the lines above a table state about the recording: device, rate, start, kind of values."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from imucalib.errors import UnreadableInput

_NUMBER = r"(\d+(?:[.,]\d+)?)"
_RATE = re.compile(
    rf"(?:\bat\s+|(?:sampl\w*\s*(?:rate|freq\w*)|measurement frequency|update rate|rate)"
    rf"[^0-9\n]{{0,12}}){_NUMBER}\s*(?:hz\b|$|[,;\s])",
    re.IGNORECASE,
)
_EPOCH = re.compile(r"epoch period[^0-9]*(\d+):(\d+):(\d+)", re.IGNORECASE)
_START_TIME = re.compile(r"start time[\s,;:]*(\d{1,2}):(\d{2}):(\d{2})", re.IGNORECASE)
_START_DATE = re.compile(r"start date[\s,;:]*(\d+)[/.\-](\d+)[/.\-](\d+)", re.IGNORECASE)
_DATE_FORMAT = re.compile(r"date format\s+(\S+)", re.IGNORECASE)
_OWN_ROWS = re.compile(r"# imucal recording, rows: (\d+)")
_OWN_START = re.compile(r"start_ns\s*[:=]\s*(-?\d+)")


@dataclass(frozen=True)
class HeaderFacts:
    """device : "actigraph", "geneactiv", "xsens" or ""; rate in Hz; start_ns as in Recording.

    rows : how many rows the file says that it has, or None
    """

    device: str = ""
    rate: float | None = None
    start_ns: int | None = None
    notes: tuple[str, ...] = ()
    rows: int | None = None


def facts_of(preamble: Sequence[str], where: str) -> HeaderFacts:
    """Read the lines above the table. Raises UnreadableInput for epoch counts."""
    text = "\n".join(preamble)
    lower = text.lower()
    found = _RATE.search(text)
    rate = float(found.group(1).replace(",", ".")) if found else None
    own = _OWN_START.search(text)
    start = int(own.group(1)) if own else None
    notes: tuple[str, ...] = ()
    if "actigraph" in lower or "actilife" in lower:
        _refuse_epochs(text, where)
        start, notes = _actigraph_start(text)
        return HeaderFacts("actigraph", rate or None, start, notes)
    device = "geneactiv" if "geneactiv" in lower else ""
    if not device and ("mt manager" in lower or "xsens" in lower or "xda version" in lower):
        device = "xsens"
    stated = _OWN_ROWS.search(text)
    rows = int(stated.group(1)) if stated else None
    return HeaderFacts(device, rate or None, start, notes, rows)


def _refuse_epochs(text: str, where: str) -> None:
    found = _EPOCH.search(text)
    if found and any(int(part) for part in found.groups()):
        period = ":".join(found.groups())
        raise UnreadableInput(
            f"this ActiGraph file holds activity counts per epoch of {period}, not acceleration",
            where=where,
            remedy="give the .gt3x file itself, or export raw data (RAW CSV) instead of epochs",
        )


def _actigraph_start(text: str) -> tuple[int | None, tuple[str, ...]]:
    time, date = _START_TIME.search(text), _START_DATE.search(text)
    if not time or not date:
        return None, ()
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
        return None, ("the header's start date is not a date: no start time",)
    hours, minutes, seconds = (int(g) for g in time.groups())
    start = midnight + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    return int(start.timestamp()) * 1_000_000_000, notes
