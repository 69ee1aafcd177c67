"""Time stamps of a text table, vectorised: dates and times as text, or several columns of them.

A stamp is groups of digits in an order that is found once, and perhaps words: a zone, AM or PM, a
month's name. Stamps that differ in digits alone have one form, which is looked at once; a form that
has anything else in it is not understood. No cast of numpy's parses a text: those that raise take
the interpreter down beyond 500 elements (numpy 2.4).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags, Index
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields.timebase import runs_of
from imucalib.readers.fields.words import by_word

Int = NDArray[np.int64]
Codes = NDArray[np.uint8]
MISSING = np.iinfo(np.int64).min  #: a blank stamp
_BLANK = [b"", b"nan", b"na", b"null"]
_PER_DAY, _PER_HOUR, _PER_MINUTE = 86_400_000_000_000, 3_600_000_000_000, 60_000_000_000
_DIRECTIVE = dict(zip("YymbBdHIMSf", "YYMMMDhhmsf", strict=True)) | {"T": "hms", "F": "YMD"}
_SILENT_DIRECTIVES = "pzZ"
#: Digits that a group may have, by its letter: C is YYYYMMDD, H hhmmss, i and u whole ms and us.
_LONGEST = {"Y": 4, "C": 8, "H": 6, "f": 9, "i": 3, "u": 6}
#: Hours east of UTC. RFC 2822, 4.3, and Europe's; those that name two zones (CST, IST, BST) are
#: left out.
_ZONES = by_word(
    {
        0: "z utc ut gmt wet",
        1: "west cet met mez",
        2: "cest mest mesz eet",
        3: "eest msk",
        9: "jst kst",
        -5: "est cdt",
        -4: "edt",
        -7: "mst pdt",
        -6: "mdt",
        -8: "pst",
    }
)
_HALF = rb"(?:\s*([ap])\.?\s?m\.?)"
#: What ends a stamp after a digit or a half of the day: a zone, and its name in brackets.
_TAIL = re.compile(
    rb"(?<=[\dm.])(\s*(?:(" + "|".join(sorted(_ZONES, reverse=True)).encode() + rb")|"
    rb"(?:utc|gmt)?([+-])(\d{1,2})(?::?(\d\d))?)\s*(?:\[[^\]]*\])?\s*)$"
)
#: An offset follows a time of day; "-15" after a month is a day.
_TIMED = re.compile(rb"(?::\d\d(?:[.,]\d*)?|t\d{4,6}(?:[.,]\d*)?)" + _HALF + rb"?$")
_HALF_AT_END = re.compile(_HALF + rb"\s*$")
_MONTH = re.compile(rb"[a-z\x80-\xff]{3,}\.?")
_MONTHS = {
    name: k
    for k, names in enumerate(
        str.split("jan feb mar/mär/mrz apr may/mai jun jul aug sep oct/okt nov dec/dez"), start=1
    )
    for name in names.split("/")
}
_BETWEEN, _CLOCK = rb"[\s\-:/.,_t]+", rb"\d\d?[:.\-_]\d\d?[:.\-_]\d\d?([.,:]\d+)?"
_DATE = rb"\d\d?" + _BETWEEN + rb"\d\d?" + _BETWEEN + rb"(\d\d|\d{4})" + _BETWEEN
_YEAR = rb"\d{4}" + _BETWEEN + rb"\d\d?" + _BETWEEN + rb"\d\d?" + _BETWEEN
#: Stamp without words -> order of its groups; x is the day or the month.
_ORDERS = {
    rb"\d{8}[t _-]\d{6}([.,]\d+)?": "CHf",
    rb"\d{8}[t _-]" + _CLOCK: "Chmsf",
    rb"\d{8}[t _-]\d\d?:\d\d": "Chm",
    rb"\d\d?:\d\d?[.,]\d+": "msf",
    _CLOCK: "hmsf",
    _YEAR + _CLOCK: "YMDhmsf",
    _YEAR + rb"\d\d?:\d\d": "YMDhm",
    _DATE + _CLOCK: "xxYhmsf",
    _DATE + rb"\d\d?:\d\d": "xxYhm",
}
_UNDERSTOOD = re.compile(rb"[\d\0 \-:/.,_t]*")
_MOST_FORMS = 1000  # that one block of stamps is looked through for
#: A form's key: sums of its bytes by powers of an odd number, in 64 bits.
_KEYS = [pow(0x9E3779B97F4A7C15, k, 1 << 64) for k in range(1, 129)]


@dataclass(frozen=True)
class TextTime:
    """What text stamps are made of.

    order : of the digit groups: Y M D h m s f, and the letters of `_LONGEST`
    dated : whether there is a date; ambiguous : day and month cannot be told apart
    zone, half, months : whether each stamp has a zone, AM or PM, the name of a month
    literal : letters that the user's format has in it
    """

    order: str
    dated: bool
    ambiguous: bool = False
    zone: bool = False
    half: bool = False
    months: bool = False
    literal: tuple[bytes, ...] = ()

    @property
    def period(self) -> float:
        """Seconds after which stamps without a date begin again."""
        return 86_400.0 if set(self.order) & {"h", "H"} else 3600.0


@dataclass(frozen=True)
class _Form:
    """Stamps that differ in digits alone.

    plain : the text with blanks for its words and digits for its month; month : where these are
    east : offset from UTC by a zone's name, ns; sign, hours, minutes : of an offset in digits
    """

    plain: bytes
    month: int = -1
    afternoon: int = 0
    east: int = 0
    sign: int = 0
    hours: tuple[int, int] = (0, 0)
    minutes: tuple[int, int] = (0, 0)


def _form_of(stamp: bytes, layout: TextTime) -> _Form | None:
    """The form of a lower-case stamp; None where it lacks a word that the others have."""
    for word in layout.literal:
        stamp = stamp.replace(word, b" " * len(word))
    east, sign, hours, minutes, afternoon, month = 0, 0, (0, 0), (0, 0), 0, -1
    if layout.zone:
        found = _TAIL.search(stamp)
        if found is None or not (found[2] or _TIMED.search(stamp[: found.start(1)].rstrip())):
            return None
        if found[2]:
            east = _ZONES[found[2].decode()] * _PER_HOUR
        else:
            sign, hours = (-1 if found[3] == b"-" else 1), found.span(4)
            minutes = found.span(5) if found[5] else (0, 0)
        stamp = stamp[: found.start(1)]
    if layout.half:
        found = _HALF_AT_END.search(stamp)
        if found is None:
            return None
        afternoon, stamp = int(found[1] == b"p"), stamp[: found.start()]
    if layout.months:
        named = _month(stamp)
        if named is None:
            return None
        (month, stop), number = named
        stamp = stamp[:month] + (b"%02d" % number).ljust(stop - month) + stamp[stop:]
    return _Form(
        stamp, month=month, afternoon=afternoon, east=east, sign=sign, hours=hours, minutes=minutes
    )


def _month(stamp: bytes) -> tuple[tuple[int, int], int] | None:
    """Where a stamp names a month, and the month's number."""
    for found in _MONTH.finditer(stamp):
        number = _MONTHS.get(found.group().decode(errors="replace")[:3])
        if number:
            return found.span(), number
    return None


def text_layout(samples: list[bytes], time_format: str, where: str) -> TextTime:
    """The order of the digit groups that fits most sample stamps. Raises UnreadableInput."""
    low = [s.lower().strip() for s in samples]

    def most(words: TextTime) -> bool:
        return 2 * sum(_form_of(s, words) is not None for s in low) > len(low)

    plain = TextTime("", True)
    plain = replace(plain, zone=most(replace(plain, zone=True)))
    plain = replace(plain, half=most(replace(plain, half=True)))
    if time_format:
        return _by_format(time_format, plain)
    plain = replace(plain, months=most(replace(plain, months=True)))
    forms = [(s, f.plain.strip()) for s in low if (f := _form_of(s, plain)) is not None]
    shapes = [re.sub(rb"\s+", b" ", re.sub(rb"\d+", b"0", text)) for _, text in forms]
    usual = Counter(shapes).most_common(1)
    # A fraction that some stamps lack is no other form.
    examples = [f for f, shape in zip(forms, shapes, strict=True) if shape == usual[0][0]]
    first, example = examples[0] if examples else (b"", b"")
    odd = [w for w in re.findall(rb"[^\d\s\-:/.,_]+", example) if w != b"t"]
    groups = [re.findall(rb"\d+", text) for _, text in examples or [(b"", b"")]]
    named_first = not first[:1].isdigit() if plain.months else None
    order = None if odd else _order_of(groups, example, named_first)
    if order is None:
        stamp = samples[0].decode(errors="replace") if samples else ""
        what = f"'{odd[0].decode(errors='replace')}' in " if odd else ""
        raise UnreadableInput(
            f"{what}the time stamp '{stamp[:60]}' is not understood",
            where=where,
            remedy="give --time-format, for example '%d/%m/%Y %H:%M:%S.%f'; letters in it are "
            "passed over",
        )
    letters, dated, ambiguous = order
    return replace(plain, order=letters, dated=dated, ambiguous=ambiguous)


def _by_format(text: str, plain: TextTime) -> TextTime:
    letters = re.findall(r"%([A-Za-z])", text)
    unknown = [c for c in letters if c not in _DIRECTIVE and c not in _SILENT_DIRECTIVES]
    if unknown:
        known = " ".join(f"%{c}" for c in (*_DIRECTIVE, *_SILENT_DIRECTIVES))
        raise UsageError(
            f"%{unknown[0]} of the time format is not understood",
            where="--time-format",
            remedy=f"use of: {known}",
        )
    order = "".join(_DIRECTIVE.get(c, "") for c in letters)
    words = re.findall(r"[^\W\d_]+", re.sub(r"%[A-Za-z]", " ", text))
    literal = tuple(w.lower().encode() for w in words if w.lower() != "t")
    return replace(
        plain,
        order=order,
        dated={"Y", "M", "D"} <= set(order),
        zone=plain.zone and not literal,
        months=bool(set(letters) & {"b", "B"}),
        literal=literal,
    )


def _order_of(
    groups: list[list[bytes]], example: bytes, named_first: bool | None
) -> tuple[str, bool, bool] | None:
    """Order of the groups, whether they hold a date, and whether it is ambiguous.

    named_first : of dates whose month is a name, whether it comes first
    """
    order = next((found for form, found in _ORDERS.items() if re.fullmatch(form, example)), None)
    if order is None or "x" not in order:
        return None if order is None else (order, bool({"C", "Y"} & set(order)), False)
    clock = order.removeprefix("xxY")
    first, second = {int(g[0]) for g in groups}, {int(g[1]) for g in groups}
    if named_first is not None:
        return ("MDY" if named_first else "DMY") + clock, True, False
    dotted = b"." in example.split()[0]
    day_first, month_first = max(first) > 12 or dotted, max(second) > 12
    # Of "23-11-15" the first may be the year as well.
    ambiguous = not day_first and not month_first
    ambiguous |= day_first and not dotted and len(groups[0][2]) == 2 and b"-" in example
    faster = ambiguous and len(first) > len(second)  # days run faster than months
    return ("DMY" if day_first or faster else "MDY") + clock, True, ambiguous and not faster


def text_to_ns(stamps: NDArray[np.bytes_], layout: TextTime) -> tuple[Int, Flags]:
    """(n,) nanoseconds since 1970 (UTC when a zone is stated), or since the start of the period
    without a date; and which stamps are not understood. These and blank ones are MISSING."""
    out = np.full(stamps.shape, MISSING, dtype=np.int64)
    codes = np.frombuffer(stamps.tobytes(), dtype=np.uint8).reshape(stamps.size, -1)
    codes = np.where((codes >= 65) & (codes <= 90), codes + np.uint8(32), codes)  # lower case
    filled = np.flatnonzero(~np.isin(codes.view(stamps.dtype)[:, 0], _BLANK))
    wrong = np.zeros(stamps.shape, dtype=np.bool_)
    wrong[filled] = True
    codes = codes[filled]
    for shape, rows in _by_form(codes):
        form = _form_of(shape, layout)
        if form is not None and _UNDERSTOOD.fullmatch(form.plain):
            ns, bad = _read(codes[rows], form, layout)
            out[filled[rows]], wrong[filled[rows]] = np.where(bad, MISSING, ns), bad
    return out, wrong


def _by_form(codes: Codes) -> Iterator[tuple[bytes, Index | slice]]:
    """Every form of stamps (n, width), with zeros for its digits, and the rows that have it."""
    shapes = np.where((codes >= 48) & (codes <= 57), np.uint8(48), codes)
    if not len(shapes):
        return
    if (shapes == shapes[0]).all():
        yield shapes[0].tobytes().rstrip(b"\0"), slice(None)
        return
    keys = shapes @ np.resize(np.array(_KEYS, np.uint64), shapes.shape[1])
    _, first, which = np.unique(keys, return_index=True, return_inverse=True)
    order = np.argsort(which, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(which[order])) + 1)
    for one, rows in zip(first[:_MOST_FORMS], parts, strict=False):
        same = (shapes[rows] == shapes[one]).all(axis=1)
        yield shapes[one].tobytes().rstrip(b"\0"), rows[same]


def _number(codes: Codes, span: tuple[int, int]) -> Int:
    """The numbers (n,) that the digits in a span are."""
    out = np.zeros(len(codes), dtype=np.int64)
    for column in range(*span):
        out = out * 10 + (codes[:, column] - np.int64(48))
    return out


def _read(codes: Codes, form: _Form, layout: TextTime) -> tuple[Int, Flags]:
    """Stamps of one form in ns, and which are impossible."""
    spans = [found.span() for found in re.finditer(rb"\d+", form.plain)]
    order = layout.order
    zero, every = np.zeros(len(codes), dtype=np.int64), np.ones(len(codes), dtype=np.bool_)
    if not len(order) - order.endswith("f") <= len(spans) <= len(order):
        return zero, every
    size = {letter: stop - start for letter, (start, stop) in zip(order, spans, strict=False)}
    if any(n > _LONGEST.get(c, 2) for c, n in size.items()) or size.get("H", 6) != 6:
        return zero, every
    at = {letter: _number(codes, span) for letter, span in zip(order, spans, strict=False)}
    if form.month >= 0:
        number = int(form.plain[form.month : form.month + 2])
        at |= {c: zero + number for c, s in zip(order, spans, strict=False) if s[0] == form.month}
    if "H" in at:
        at |= {"h": at["H"] // 10_000, "m": at["H"] // 100 % 100, "s": at["H"] % 100}
    hour, minute, second = (at.get(letter, zero) for letter in "hms")
    bad = (hour > 23) | (minute > 59) | (second > 59)
    if layout.half:
        bad |= (hour > 12) & (form.afternoon == 0)
        hour = np.where(hour > 12, hour, hour % 12 + 12 * form.afternoon)
    ns = ((hour * 60 + minute) * 60 + second) * 1_000_000_000
    ns += at.get("f", zero) * 10 ** (9 - size.get("f", 9))
    ns += at.get("i", zero) * 1_000_000 + at.get("u", zero) * 1000
    if layout.dated:
        days, impossible = _days(at, size)
        bad, ns = bad | impossible, ns + days * _PER_DAY
    hours, minutes = _number(codes, form.hours), _number(codes, form.minutes)
    bad |= (hours > 14) | (minutes > 59)
    east = form.east + form.sign * (hours * _PER_HOUR + minutes * _PER_MINUTE)
    return ns - east, bad


def _days(at: dict[str, Int], size: dict[str, int]) -> tuple[Int, Flags]:
    """Days since 1970, and which dates are none."""
    if "C" in at:
        year, month, day = at["C"] // 10_000, at["C"] // 100 % 100, at["C"] % 100
    else:
        year, month, day = at["Y"] + (2000 if size["Y"] <= 2 else 0), at["M"], at["D"]
    bad = (month < 1) | (month > 12) | (day < 1) | (day > 31) | (year < 1678) | (year > 2261)
    year, month = np.where(bad, 1970, year), np.where(bad, 1, month)
    months = ((year - 1970) * 12 + month - 1).astype("M8[M]")
    dates = months.astype("M8[D]") + (day - 1).clip(0, 30).astype("m8[D]")
    return dates.astype(np.int64), np.asarray(bad | (dates.astype("M8[M]") != months))


def spread_rows(stamps: Array, resolution: float, typical: float, first: bool) -> Array:
    """Delay (s) of each row after its coarse stamp, even over the step to the next stamp.

    stamps : (n,) s, in which every group of equal stamps is complete, except the first one when
    `first` says so: it then ends where its step ends. resolution : s; typical : rows per step.
    """
    _, counts, rank = runs_of(stamps)
    group = np.repeat(np.arange(counts.size), counts)
    room = np.maximum(counts, typical)
    lead = np.zeros(counts.shape)
    if first and counts.size:
        lead[0] = room[0] - counts[0]
    moved: Array = (rank + lead[group]) / room[group] * resolution
    return moved
