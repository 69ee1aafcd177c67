"""Time stamps of a text table, vectorised: integers, decimals, or dates and times as text."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput

Int = NDArray[np.int64]
MISSING = np.iinfo(np.int64).min  #: a blank stamp
_SUFFIX = re.compile(rb"\s*(Z|UTC|[+-]\d{2}:?\d{2})?\s*(\[[^\]]*\])?\s*$")
_DIRECTIVE = {"Y": "Y", "y": "Y", "m": "M", "d": "D", "H": "h", "M": "m", "S": "s", "f": "f",
              "I": "h"}  # fmt: skip
_PER_DAY = 86_400_000_000_000


@dataclass(frozen=True)
class TextTime:
    """Order of the digit groups of a text stamp: Y M D h m s f; and whether it is ambiguous."""

    order: str
    dated: bool
    ambiguous: bool = False
    zone: bool = False


def text_layout(samples: list[bytes], time_format: str, where: str) -> TextTime:
    """The order of the digit groups that fits all sample stamps. Raises UnreadableInput."""
    bare = [_SUFFIX.sub(b"", s) for s in samples]
    zone = any(_offset_ns(s) is not None for s in samples)
    if time_format:
        letters = re.findall(r"%([A-Za-z])", time_format)
        order = "".join(_DIRECTIVE.get(c, "") for c in letters)
        return TextTime(order, {"Y", "M", "D"} <= set(order), zone=zone)
    groups = [re.findall(rb"\d+", s) for s in bare]
    if not groups or {len(g) for g in groups} - {6, 7, 3, 4} or not groups[0]:
        raise UnreadableInput(
            f"the time stamp '{samples[0].decode(errors='replace') if samples else ''}' is not "
            "understood",
            where=where,
            remedy="give --time-format, for example %d/%m/%Y %H:%M:%S.%f",
        )
    if len(groups[0]) <= 4:
        return TextTime("hmsf", False)
    if len(groups[0][0]) == 4:
        return TextTime("YMDhmsf", True, zone=zone)
    first = {int(g[0]) for g in groups}
    second = {int(g[1]) for g in groups}
    day_first = max(first) > 12 or b"." in bare[0].split()[0]
    month_first = max(second) > 12
    ambiguous = not day_first and not month_first
    if ambiguous and len(first) > len(second):  # days run faster than months
        return TextTime("DMYhmsf", True, False, zone)
    return TextTime("DMYhmsf" if day_first else "MDYhmsf", True, ambiguous, zone)


def text_to_ns(stamps: NDArray[np.bytes_], layout: TextTime) -> Int:
    """Nanoseconds since 1970 (UTC when a zone is stated), or since midnight without a date.

    Blank stamps become MISSING. Raises ValueError with the index of the first bad stamp.
    """
    out = np.full(stamps.shape, MISSING, dtype=np.int64)
    blank = np.isin(np.char.lower(stamps), [b"", b"nan", b"na", b"null"])
    filled = np.flatnonzero(~blank)
    if filled.size == 0:
        return out
    texts = stamps[filled]
    if layout.order == "YMDhmsf":
        with suppress(ValueError):
            out[filled] = _iso(texts)
            return out
    try:
        out[filled] = _by_groups(texts, layout)
    except ValueError as error:
        if error.args and isinstance(error.args[0], int | np.integer):
            raise ValueError(int(filled[error.args[0]])) from error
        raise
    return out


def _iso(texts: NDArray[np.bytes_]) -> Int:
    """C parsing of plain ISO 8601; ValueError sends the stamps to the general parser."""
    if b"+" in texts[0] or b"Z" in texts[0] or b"[" in texts[0] or texts[0].count(b":") != 2:
        raise ValueError("not plain")
    if texts[0].count(b"-") != 2 or b"," in texts[0]:
        raise ValueError("not plain")
    joined = texts.tobytes()
    if any(c in joined for c in (b"+", b"Z", b"N", b"n", b"T-", b"t")):
        raise ValueError("not plain")
    parsed = texts.astype("M8[ns]").astype(np.int64)
    if (parsed == MISSING).any():
        raise ValueError("not plain")
    return np.asarray(parsed)


def _by_groups(texts: NDArray[np.bytes_], layout: TextTime) -> Int:
    offsets = np.zeros(texts.shape, dtype=np.int64)
    if layout.zone:
        texts, offsets = _without_zone(texts)
    fields, digits = _digit_groups(texts, layout.order)
    at = {letter: fields[:, k] for k, letter in enumerate(layout.order[: fields.shape[1]])}
    hour = at["h"]
    upper = np.char.upper(texts)
    afternoon, morning = np.char.find(upper, b"PM") >= 0, np.char.find(upper, b"AM") >= 0
    hour = np.where(afternoon & (hour < 12), hour + 12, np.where(morning & (hour == 12), 0, hour))
    minute, second = at["m"], at.get("s", np.zeros_like(hour))
    _check((hour < 24) & (minute < 60) & (second < 61))
    ns = ((hour * 60 + minute) * 60 + second) * 1_000_000_000
    if "f" in at:
        length = digits[:, layout.order.index("f")]
        _check(length <= 9)
        ns = ns + at["f"] * 10 ** (9 - length)
    if layout.dated:
        year = np.where(at["Y"] < 100, at["Y"] + 2000, at["Y"])
        month, day = at["M"], at["D"]
        _check((month >= 1) & (month <= 12) & (day >= 1) & (day <= 31) & (year < 2262))
        months = ((year - 1970) * 12 + month - 1).astype("M8[M]")
        dates = months.astype("M8[D]") + (day - 1).astype("m8[D]")
        _check(dates.astype("M8[M]") == months)
        ns = ns + dates.astype(np.int64) * _PER_DAY
    return np.asarray(ns - offsets)


def _check(good: NDArray[np.bool_] | np.bool_) -> None:
    if not np.all(good):
        raise ValueError(int(np.argmin(good)))


def _digit_groups(texts: NDArray[np.bytes_], order: str) -> tuple[Int, Int]:
    """Value and length of each run of digits, (n, groups). ValueError(index) for an odd stamp."""
    width = texts.dtype.itemsize
    codes = np.zeros((texts.size, width + 2), dtype=np.uint8)
    codes[:, 1:-1] = np.frombuffer(texts.tobytes(), dtype=np.uint8).reshape(texts.size, width)
    is_digit = (codes >= 48) & (codes <= 57)
    edge = np.diff(is_digit.astype(np.int8), axis=1)
    per_row = (edge == 1).sum(axis=1)
    groups = int(np.median(per_row))
    known = min(groups, len(order))
    if known < len(order.rstrip("f")):
        raise ValueError(0)
    start, stop = np.flatnonzero(edge == 1), np.flatnonzero(edge == -1)
    if not (per_row == groups).all():
        return _uneven_groups(texts, order, per_row)
    length = (stop - start).reshape(-1, groups)[:, :known]
    begin = start.reshape(-1, groups)[:, :known] % (width + 1)
    _check((length <= 9).all(axis=1))
    values = np.zeros(length.shape, dtype=np.int64)
    rows = np.arange(texts.size)[:, None]
    for k in range(int(length.max())):
        inside = k < length
        digit = codes[rows, np.minimum(begin + 1 + k, width)].astype(np.int64) - 48
        values = np.where(inside, values * 10 + digit, values)
    return values, length


def _uneven_groups(texts: NDArray[np.bytes_], order: str, per_row: Int) -> tuple[Int, Int]:
    """Stamps of which only some have a fraction: those without get a zero one."""
    full = len(order) if order.endswith("f") else -1
    _check((per_row == full) | (per_row == full - 1))
    short = per_row == full - 1
    padded = texts.astype(f"S{texts.dtype.itemsize + 2}")
    padded[short] = np.char.add(texts[short], b".0")
    return _digit_groups(padded, order)


def _offset_ns(stamp: bytes) -> int | None:
    found = _SUFFIX.search(stamp)
    zone = found.group(1) if found else None
    if zone is None:
        return None
    if zone in (b"Z", b"UTC"):
        return 0
    sign = -1 if zone[:1] == b"-" else 1
    digits = zone[1:].replace(b":", b"")
    return sign * (int(digits[:2]) * 60 + int(digits[2:])) * 60_000_000_000


def _without_zone(texts: NDArray[np.bytes_]) -> tuple[NDArray[np.bytes_], Int]:
    """Stamps without their zone, and its offset in ns; a loop over the distinct zones only."""
    bare, offsets = texts.copy(), np.zeros(texts.shape, dtype=np.int64)
    left = np.ones(texts.shape, dtype=np.bool_)
    for _ in range(32):
        todo = np.flatnonzero(left)
        if todo.size == 0:
            return bare, offsets
        sample = bytes(texts[todo[0]])
        found = _SUFFIX.search(sample)
        suffix = found.group(0) if found else b""
        offset = _offset_ns(sample)
        if offset is None:
            raise ValueError(int(todo[0]))
        same = todo[np.char.endswith(texts[todo], suffix)]
        bare[same] = np.char.replace(texts[same], suffix, b"")
        offsets[same] = offset
        left[same] = False
    raise ValueError(int(np.flatnonzero(left)[0]))


def spread(stamps: Array, resolution: float, typical: float, first: bool) -> Array:
    """Delay (s) of each row after its coarse stamp, even over the step to the next stamp.

    stamps : (n,) s, in which every group of equal stamps is complete, except the first one when
    `first` says so: it then ends where its step ends. resolution : s; typical : rows per step.
    """
    starts = np.flatnonzero(np.diff(stamps, prepend=stamps[:1] - 1))
    counts = np.diff(starts, append=stamps.size)
    group = np.repeat(np.arange(starts.size), counts)
    rank = np.arange(stamps.size) - starts[group]
    room = np.maximum(counts, typical)
    lead = np.zeros(counts.shape)
    if first and counts.size:
        lead[0] = room[0] - counts[0]
    moved: Array = (rank + lead[group]) / room[group] * resolution
    return moved
