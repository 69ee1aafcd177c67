"""Time stamps of a text table, vectorised: dates and times as text, or several columns of them.

A stamp is groups of digits in an order that is found once, and perhaps words: a zone, AM or PM, a
month's name. Whatever else stands in it makes that stamp one that is not understood. No cast of
numpy's parses a text: those that raise take the interpreter down beyond 500 elements (numpy 2.4).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput, UsageError

Int = NDArray[np.int64]
Bool = NDArray[np.bool_]
Texts = NDArray[np.bytes_]
MISSING = np.iinfo(np.int64).min  #: a blank stamp
_BLANK = [b"", b"nan", b"na", b"null"]
_PER_DAY = 86_400_000_000_000
_DIRECTIVE = dict(zip("YymbBdHIMSf", "YYMMMDhhmsf", strict=True)) | {"T": "hms", "F": "YMD"}
_SILENT_DIRECTIVES = "pzZ"
#: Digits that a group may have, by its letter: C is YYYYMMDD, H hhmmss, i and u whole ms and us.
_LONGEST = {"Y": 4, "C": 8, "H": 6, "f": 9, "i": 3, "u": 6}
#: Hours east of UTC. RFC 2822, 4.3, and Europe's; those that name two zones (CST, IST, BST) are
#: left out.
_ZONES = {
    name.encode(): hours
    for hours, names in {
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
    }.items()
    for name in names.split()
}
_HALF = rb"(?:\s*([ap])\.?\s?m\.?)"
#: What ends a stamp behind a digit or a half of the day: a zone, and its name in brackets.
_TAIL = re.compile(
    rb"(?<=[\dm.])(\s*(?:(" + b"|".join(sorted(_ZONES, reverse=True)) + rb")|"
    rb"(?:utc|gmt)?([+-])(\d{1,2})(?::?(\d\d))?)\s*(?:\[[^\]]*\])?\s*)$"
)
#: An offset stands behind a time of day; "-15" behind a month is a day.
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
#: Form of a stamp without words -> order of its groups; x is the day or the month.
_FORMS = {
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
_MOST_FORMS = 64  # zones, halves or months that one block of stamps is looked through for
_SEPARATOR = np.zeros(256, dtype=np.bool_)
_SEPARATOR[list(b"\0 -:/.,_t")] = True


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


def text_layout(samples: list[bytes], time_format: str, where: str) -> TextTime:
    """The order of the digit groups that fits most sample stamps. Raises UnreadableInput."""
    low = [s.lower().strip() for s in samples]
    zone, half = (2 * sum(found(s) for s in low) > len(low) for found in (_has_zone, _has_half))
    if time_format:
        return _by_format(time_format, zone, half)
    plain = TextTime("", True, zone=zone, half=half)
    bare, _, _, _ = _without_words(np.array(low or [b""]), plain)
    months = 2 * sum(_month(bytes(s)) is not None for s in bare) > len(bare)
    if months:
        bare, _ = _with_numbers(bare)
    texts = [bytes(s).strip() for s in bare]
    usual = _usual([re.sub(rb"\d+", b"0", t) for t in texts])
    examples = [t for t in texts if re.sub(rb"\d+", b"0", t) == usual] or [b""]
    odd = [w for w in re.findall(rb"[^\d\s\-:/.,_]+", examples[0]) if w != b"t"]
    groups = [re.findall(rb"\d+", t) for t in examples]
    named_first = None if not months else not low[texts.index(examples[0])][:1].isdigit()
    order = None if odd else _order_of(groups, examples[0], named_first)
    if order is None:
        stamp = samples[0].decode(errors="replace") if samples else ""
        what = f"'{odd[0].decode(errors='replace')}' in " if odd else ""
        raise UnreadableInput(
            f"{what}the time stamp '{stamp[:60]}' is not understood",
            where=where,
            remedy="give --time-format, for example '%d/%m/%Y %H:%M:%S.%f'; letters in it are "
            "passed over",
        )
    return TextTime(*order, zone, half, months)


def _usual(shapes: list[bytes]) -> bytes:
    """The commonest form; a fraction that some stamps lack is no other form."""
    found = Counter(shapes).most_common(1)
    return found[0][0] if found else b""


def _by_format(text: str, zone: bool, half: bool) -> TextTime:
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
    return TextTime(
        order,
        {"Y", "M", "D"} <= set(order),
        zone=zone and not literal,
        half=half,
        months=bool(set(letters) & {"b", "B"}),
        literal=literal,
    )


def _order_of(
    groups: list[list[bytes]], example: bytes, named_first: bool | None
) -> tuple[str, bool, bool] | None:
    """Order of the groups, whether they hold a date, and whether it is ambiguous.

    named_first : of dates whose month is a name, whether it stands first
    """
    order = next((found for form, found in _FORMS.items() if re.fullmatch(form, example)), None)
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


def text_to_ns(stamps: Texts, layout: TextTime) -> tuple[Int, Bool]:
    """(n,) nanoseconds since 1970 (UTC when a zone is stated), or since the start of the period
    without a date; and which stamps are not understood. These and blank ones are MISSING."""
    out = np.full(stamps.shape, MISSING, dtype=np.int64)
    wrong = np.zeros(stamps.shape, dtype=np.bool_)
    low = np.char.lower(stamps)
    filled = np.flatnonzero(~np.isin(low, _BLANK))
    if filled.size:
        ns, bad = _read(low[filled], layout)
        out[filled], wrong[filled] = np.where(bad, MISSING, ns), bad
    return out, wrong


def _read(texts: Texts, layout: TextTime) -> tuple[Int, Bool]:
    texts, offsets, afternoon, bad = _without_words(texts, layout)
    if layout.months:
        texts, absent = _with_numbers(texts)
        bad = bad | absent
    values, digits, odd = _digit_groups(texts, layout.order)
    bad = bad | odd
    at = {letter: values[:, k] for k, letter in enumerate(layout.order)}
    size = {letter: digits[:, k] for k, letter in enumerate(layout.order)}
    for letter, length in size.items():
        bad = bad | (length > _LONGEST.get(letter, 2))
    zero = np.zeros(texts.shape, dtype=np.int64)
    if "H" in at:
        bad = bad | (size["H"] != 6)
        at |= {"h": at["H"] // 10_000, "m": at["H"] // 100 % 100, "s": at["H"] % 100}
    hour, minute, second = (at.get(letter, zero) for letter in "hms")
    if layout.half:
        bad = bad | ((hour > 12) & (afternoon == 0))
        hour = np.where(hour > 12, hour, hour % 12 + 12 * afternoon)
    bad = bad | (hour > 23) | (minute > 59) | (second > 60)
    ns = ((hour * 60 + minute) * 60 + second) * 1_000_000_000
    if "f" in at:
        ns = ns + at["f"] * 10 ** np.clip(9 - size["f"], 0, 9)
    ns = ns + at.get("i", zero) * 1_000_000 + at.get("u", zero) * 1000
    if layout.dated:
        days, impossible = _days(at, size)
        bad, ns = bad | impossible, ns + days * _PER_DAY
    return np.asarray(ns - offsets), bad


def _days(at: dict[str, Int], size: dict[str, Int]) -> tuple[Int, Bool]:
    """Days since 1970, and which dates are none."""
    if "C" in at:
        year, month, day = at["C"] // 10_000, at["C"] // 100 % 100, at["C"] % 100
    else:
        year, month, day = at["Y"], at["M"], at["D"]
        year = np.where(size["Y"] <= 2, year + 2000, year)
    bad = (month < 1) | (month > 12) | (day < 1) | (day > 31) | (year < 1678) | (year > 2261)
    year, month = np.where(bad, 1970, year), np.where(bad, 1, month)
    months = ((year - 1970) * 12 + month - 1).astype("M8[M]")
    dates = months.astype("M8[D]") + (day - 1).clip(0, 30).astype("m8[D]")
    return dates.astype(np.int64), np.asarray(bad | (dates.astype("M8[M]") != months))


def _digit_groups(texts: Texts, order: str) -> tuple[Int, Int, Bool]:
    """(n, groups) value and length of each run of digits, and which stamps are not of them."""
    width, groups = texts.dtype.itemsize, len(order)
    codes = np.frombuffer(texts.tobytes(), dtype=np.uint8).reshape(texts.size, width)
    digit = (codes >= 48) & (codes <= 57)
    odd = ~(digit | _SEPARATOR[codes]).all(axis=1)
    values = np.zeros((texts.size, groups), dtype=np.int64)
    length = np.zeros((texts.size, groups), dtype=np.int64)
    if (digit == digit[0]).all():
        edges = np.flatnonzero(np.diff(digit[0].astype(np.int8), prepend=0, append=0))
        runs = edges.reshape(-1, 2).tolist()
        for k, (start, stop) in enumerate(runs[:groups]):
            length[:, k] = stop - start
            for column in range(start, min(stop, start + 18)):
                values[:, k] = values[:, k] * 10 + (codes[:, column] - 48)
        count = np.full(texts.size, len(runs))
    else:
        before = np.zeros_like(digit)
        before[:, 1:] = digit[:, :-1]
        which = np.cumsum(digit & ~before, axis=1) - 1
        count = which[:, -1] + 1
        for column in range(width):
            rows = np.flatnonzero(digit[:, column] & (which[:, column] < groups))
            k = which[rows, column]
            short = length[rows, k] < 18
            rows, k = rows[short], k[short]
            values[rows, k] = values[rows, k] * 10 + (codes[rows, column] - 48)
            length[rows, k] += 1
    return values, length, odd | (count > groups) | (count < groups - order.endswith("f"))


_Found = tuple[bytes, int] | None


def _taken(texts: Texts, look: Callable[[bytes], _Found]) -> tuple[Texts, Int, Bool]:
    """The texts without the ending that `look` finds, its number, and which have none.

    `look` is asked once for each form that occurs.
    """
    bare, number = texts.copy(), np.zeros(texts.shape, dtype=np.int64)
    left, without = np.ones(texts.shape, dtype=np.bool_), np.zeros(texts.shape, dtype=np.bool_)
    for _ in range(_MOST_FORMS):
        todo = np.flatnonzero(left)
        if not todo.size:
            break
        found = look(bytes(texts[todo[0]]))
        if found is None:
            left[todo[0]], without[todo[0]] = False, True
            continue
        same = todo[np.char.endswith(texts[todo], found[0])]
        bare[same] = np.char.rpartition(texts[same], found[0])[:, 0]
        number[same], left[same] = found[1], False
    return bare, number, without | left


def _without_words(texts: Texts, layout: TextTime) -> tuple[Texts, Int, Int, Bool]:
    """Lower-case stamps without their words, offsets from UTC in ns, whether it is afternoon (1),
    and which lack a word that the others have."""
    offsets = afternoon = np.zeros(texts.shape, dtype=np.int64)
    bad = np.zeros(texts.shape, dtype=np.bool_)
    for word in layout.literal:
        texts = np.char.replace(texts, word, b" ")
    if layout.zone:
        texts, offsets, bad = _taken(texts, _zone)
    if layout.half:
        texts, afternoon, without = _taken(np.char.rstrip(texts), _half)
        bad = bad | without
    return texts, offsets, afternoon, bad


def _zone(stamp: bytes) -> _Found:
    """The ending that states a zone, and its offset in ns."""
    found = _TAIL.search(stamp)
    if found is None:
        return None
    if found[2]:
        return found[1], _ZONES[found[2]] * 3_600_000_000_000
    hours, minutes = int(found[4]), int(found[5] or 0)
    if hours > 14 or minutes > 59 or not _TIMED.search(stamp[: found.start(1)].rstrip()):
        return None
    return found[1], (-1 if found[3] == b"-" else 1) * (hours * 60 + minutes) * 60_000_000_000


def _half(stamp: bytes) -> _Found:
    """The ending that says AM or PM, and 1 for PM."""
    found = _HALF_AT_END.search(stamp)
    return (found.group(), int(found[1] == b"p")) if found else None


def _has_zone(stamp: bytes) -> bool:
    return _zone(stamp) is not None


def _has_half(stamp: bytes) -> bool:
    zone = _zone(stamp)
    return _half(stamp[: len(stamp) - len(zone[0])] if zone else stamp) is not None


def _month(stamp: bytes) -> _Found:
    """The name of a month in a stamp, and its number."""
    for found in _MONTH.finditer(stamp):
        number = _MONTHS.get(found.group().decode(errors="replace")[:3])
        if number:
            return found.group(), number
    return None


def _with_numbers(texts: Texts) -> tuple[Texts, Bool]:
    """Stamps with months as numbers, and which of them name none."""
    width = texts.dtype.itemsize + 2
    out, left = texts.astype(f"S{width}"), np.ones(texts.shape, dtype=np.bool_)
    without = np.zeros(texts.shape, dtype=np.bool_)
    for _ in range(_MOST_FORMS):
        todo = np.flatnonzero(left)
        if not todo.size:
            break
        found = _month(bytes(texts[todo[0]]))
        if found is None:
            left[todo[0]], without[todo[0]] = False, True
            continue
        same = todo[np.char.find(texts[todo], found[0]) >= 0]
        out[same] = np.char.replace(texts[same], found[0], b"%02d" % found[1])
        left[same] = False
    return out, without | left


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
