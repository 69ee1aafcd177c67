"""Attributes of HDF5 objects in the spellings that are in use."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Any

import numpy as np

_SINCE = re.compile(r"\s*([A-Za-zµ]+)\s+since\s+(.+?)\s*$")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Spellings of the units of time in attributes.
TIME_ALIASES = {"sec": "s", "seconds": "s", "second": "s", "secs": "s", "µs": "us", "usec": "us",
                "microseconds": "us", "microsecond": "us", "msec": "ms", "milliseconds": "ms",
                "millisecond": "ms", "nsec": "ns", "nanoseconds": "ns",
                "nanosecond": "ns"}  # fmt: skip
RATE_NAMES = ("sampling_rate", "sample_rate", "SampleRate", "rate", "fs")


def text_of(value: Any) -> str:
    """An attribute as text: bytes, NUL-padded or a one-element array of them."""
    if isinstance(value, np.ndarray):
        value = value.flat[0] if value.size else ""
    if isinstance(value, bytes):
        value = value.decode("utf-8", errors="replace")
    return str(value).rstrip("\0").strip()


def unit_of(node: Any) -> str:
    """The unit attribute in any of its usual spellings, without "per count"."""
    for name in ("units", "unit", "Units", "Unit", "UNITS"):
        if name in node.attrs:
            text = text_of(node.attrs[name])
            for tail in (" per count", " per LSB", "/LSB", "/count", " per lsb"):
                text = text.removesuffix(tail)
            return text
    return ""


def fills_of(node: Any) -> list[Any]:
    """Values that stand for "no value" (netCDF's `_FillValue` and `missing_value`)."""
    names = ("_FillValue", "missing_value")
    found = [np.asarray(node.attrs[name]).flat for name in names if name in node.attrs]
    return [value for values in found for value in values if np.isreal(value)]


def clock_unit(text: str) -> tuple[str, int | None]:
    """Unit and origin (ns since 1970) of "milliseconds since 2020-01-01 12:00", else the text.

    The form is that of netCDF (CF Conventions, 4.4); an origin without a zone is UTC there.
    """
    found = _SINCE.match(text)
    if not found:
        return TIME_ALIASES.get(text.lower(), text), None
    unit = TIME_ALIASES.get(found[1].lower(), found[1])
    try:
        start = datetime.fromisoformat(_padded(found[2].removesuffix("UTC").strip()))
    except ValueError:
        return unit, None
    start = start if start.tzinfo else start.replace(tzinfo=UTC)
    return unit, round((start - _EPOCH).total_seconds() * 1e6) * 1000


def _padded(text: str) -> str:
    """The date with two digits where one is written: "2020-1-1 0:0:0" is common."""
    return re.sub(r"(?<![\d.])(\d)(?!\d)", r"0\1", text)


def number_of(node: Any, *names: str) -> float | None:
    """The first attribute of these names that is a finite number."""
    for name in names:
        if name in node.attrs:
            try:
                number = float(np.asarray(node.attrs[name]).flat[0])
            except (TypeError, ValueError, IndexError):
                continue
            if np.isfinite(number):
                return number
    return None
