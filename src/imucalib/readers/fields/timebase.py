"""The clock of a recording: step, unit, and where it has gaps. Nothing here moves a sample."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.errors import UnreadableInput
from imucalib.readers.fields.words import by_word
from imucalib.recording.mapping import TIME_UNITS, TIME_ZEROS
from imucalib.recording.recording import Gap

#: Samples a second of what this package calibrates: epochs of accelerometers take seconds, and no
#: converter of an inertial sensor is faster than the second.
SLOWEST, FASTEST = 0.1, 1e5
_FASTEST_USUAL = 8000.0  # beyond it a unit of time is doubted
#: Oscillators of sensors are off by per cent, dividers by factors of two or more: a rate that is
#: stated and one that is found contradict each other beyond the middle.
_OTHER_RATE = 2.0**0.5
_YEAR_2000, _YEAR_2100 = 946_684_800.0, 4_102_444_800.0
_MISSING_ONE = 1.75  # a step of two periods is a lost sample when the clock is clean
SIDES, _FEWEST = 9, 3  # samples on each side of a step back that decide whether it is one
_JITTERY = 5.0  # else only a step of this many times its 99th percentile is a gap
_SINCE = re.compile(r"\s*([A-Za-zµμ]+)\s+since\s+(.+?)\s*$")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
#: Spellings of the units of time.
_ALIASES = by_word(
    {
        "s": "sec secs second seconds",
        "ms": "msec msecs millis millisecond milliseconds millisec",
        "us": "µs μs usec usecs micros microsecond microseconds microsec",
        "min": "mins minute minutes",
        "ns": "nsec nsecs nanos nanosecond nanoseconds nanosec",
        "h": "hr hrs hour hours",
        "d": "day days",
        "excel": "serial",
        "datenum": "matlab",
        "julian": "jd",
    }
)


@dataclass(frozen=True)
class Stepping:
    """step : mean sampling period, s; threshold : a longer step is a gap, s."""

    step: float
    threshold: float


def measure_steps(pieces: Sequence[Array]) -> Stepping | None:
    """Step statistics of pieces of consecutive times (s); None when no time ever advances."""
    steps = np.concatenate([np.diff(t) for t in pieces]) if pieces else np.empty(0)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    if steps.size == 0:
        return None
    middle = float(np.median(steps))
    high = float(np.percentile(steps, 99))
    longest = max(_MISSING_ONE * middle, _JITTERY * high if high > 1.5 * middle else 0.0)
    return Stepping(mean_period(steps, middle), longest)


def mean_period(steps: Array, middle: float) -> float:
    """Time over samples, lost ones counted: stamps that are rounded have a median step of their
    grain (80 Hz in whole ms: 12 or 13).

    steps : positive; middle : their median, all in one unit
    """
    usual = steps[steps <= _MISSING_ONE * middle]
    period = float(usual.mean())
    taken = np.maximum(np.rint(usual / period), 1.0)
    return float(usual.sum() / taken.sum())


def runs_of(t: NDArray[Any]) -> tuple[Index, Index, Index]:
    """Where runs of equal times (n,) begin, how long they are (k,), and of each time its place in
    its run (n,)."""
    starts = np.flatnonzero(np.append(True, t[1:] != t[:-1])[: t.size])
    counts = np.diff(starts, append=t.size)
    return starts, counts, np.arange(t.size) - np.repeat(starts, counts)


def find_gaps(t: Array, rows: Array | range, threshold: float, before: float | None) -> list[Gap]:
    """Gaps and back-steps of the times of one channel (s).

    rows : number of each sample's row in the file, to tell missing values from missing rows;
    before : the last time of the previous block, or None.
    """
    gaps = []
    steps = np.diff(t)
    if before is not None and t.size and not 0.0 <= float(t[0]) - before <= threshold:
        gaps.append((before, float(t[0]), False))
    if steps.size and not (steps.min() >= 0.0 and steps.max() <= threshold):
        for k in np.flatnonzero((steps > threshold) | (steps < 0)).tolist():
            gaps.append((float(t[k]), float(t[k + 1]), int(rows[k + 1] - rows[k]) > 1))
    lost = ("no samples", "values missing")
    return [Gap(a, b, "time steps back" if b < a else lost[some]) for a, b, some in gaps]


def set_back(t: NDArray[Any], before: NDArray[Any], least: float) -> list[int]:
    """Rows of `t` at which its clock was set back by more than `least`.

    before : the last `SIDES` times in front of `t`, or fewer. A step back counts where most samples
    of both sides agree: one stamp that is wrong or late sets no clock.
    """
    whole = np.concatenate([before, t])
    rows, last = list[int](), 0
    for row in (np.flatnonzero(whole[1:] < whole[:-1] - least) + 1).tolist():
        one, other = whole[max(last, row - SIDES) : row], whole[row : row + SIDES]
        if (
            min(one.size, other.size) >= _FEWEST
            and row >= before.size
            and (np.median(other) < np.median(one) - least)
        ):
            rows.append(row - before.size)
            last = row
    return rows


def is_absolute(seconds: float) -> bool:
    """Whether seconds since 1970 fall in this century."""
    return _YEAR_2000 <= seconds <= _YEAR_2100


def start_of(ns: float, notes: list[str]) -> int | None:
    """A stated start as int64 nanoseconds since 1970; None, with a note, where it is none."""
    if abs(ns) < 2**63:
        return int(ns)
    notes.append(f"the stated start of {str(ns)[:24]} ns is no date: left out")
    return None


def contradicts(rate: float, stated: float) -> bool:
    """Whether a rate that was found cannot be the one that is stated, both in Hz."""
    return not 1.0 / _OTHER_RATE <= rate / stated <= _OTHER_RATE


def guess_unit(
    first: float, step: float, where: str, stated: float | None = None
) -> tuple[str, str]:
    """The unit of numeric time stamps from their size and step, with the sentence that says why.

    stated : the rate that the file states, Hz
    Raises UnreadableInput when more than one unit, or none, gives a rate of 5 to 8000 Hz, or when
    the numbers may be a counter.
    """
    for unit in ("s", "ms", "us", "ns", *TIME_ZEROS):
        size = TIME_UNITS[unit]
        date = is_absolute(first * size + TIME_ZEROS.get(unit, 0))
        if date and SLOWEST <= 1.0 / (step * size) <= FASTEST:
            return unit, f"time: {first:.16g} is a date when the unit is {unit}"
    rates = {u: 1.0 / (step * TIME_UNITS[u]) for u in ("s", "ms", "us", "ns", "min", "h", "d")}
    if stated:
        fitting = [u for u, rate in rates.items() if not contradicts(rate, stated)]
        said = f", as {stated:g} Hz is stated"
    else:
        fitting = [u for u in ("s", "ms", "us", "ns") if 5.0 <= rates[u] <= _FASTEST_USUAL]
        fitting = ["s"] if step < 1.0 and rates["s"] <= FASTEST else fitting
        said = f" ({rates[fitting[0]]:.6g} Hz)" if len(fitting) == 1 and step >= 1.0 else ""
    if len(fitting) == 1 and (step != 1.0 or stated):  # steps of one may be a counter
        return fitting[0], f"time: a median step of {step:.6g} -> unit {fitting[0]}{said}"
    raise UnreadableInput(
        f"the unit of the time stamps is unclear: their median step is {step:.6g}",
        where=where,
        remedy="name it with --time-unit, or give --rate",
    )


class Stamps(NamedTuple):
    """What numeric stamps say: their unit, the date of stamp zero (ns since 1970) or None, the
    first one, their steps in that unit, and how the unit was found."""

    unit: str
    epoch: int | None
    first: float | int
    steps: Stepping
    note: str


def stamps_of(
    looks: Sequence[NDArray[Any]],
    text: str,
    where: str,
    *,
    who: str,
    rate: float | None = None,
    remedy: str = "give --rate",
) -> Stamps:
    """The unit of stamps: that of the text, where it is one that is known and they are not dates in
    another, else the one that `guess_unit` finds.

    looks : stamps that are known, of consecutive rows from all over the file; text : what states
    the unit, and who : whose words it is; rate : that the file states, Hz
    Raises UnreadableInput for no stamps, for those that never advance, and for an unknown unit.
    """
    unit, epoch = clock_unit(text, where)
    first = next((s[0].item() for s in looks if s.size), None)
    if first is None:
        raise UnreadableInput("the time column holds no stamps", where=where, remedy=remedy)
    steps = measure_steps([seconds_of(s, first, "s") for s in looks])
    if steps is None:
        back = any((np.diff(s.astype(np.float64)) < 0.0).any() for s in looks)
        what = "run backwards" if back else "never advance"
        remedy = f"put the rows in the order of time, or {remedy}" if back else remedy
        raise UnreadableInput(f"the time stamps {what}", where=where, remedy=remedy)
    if unit in TIME_UNITS:
        dated = _dated_unit(unit, first, steps.step, who) if epoch is None else None
        unit, note = dated or (unit, "")
        return Stamps(unit, epoch, first, steps, note)
    guessed, note = guess_unit(first, steps.step, where, rate)
    if unit and date_of(first, guessed) is None:
        raise UnreadableInput(
            f"{who} states the unknown unit of time '{unit[:40]}'",
            where=where,
            remedy=f"name it with --time-unit: {', '.join(TIME_UNITS)}",
        )
    return Stamps(guessed, epoch, first, steps, note)


def _dated_unit(unit: str, first: float, step: float, who: str) -> tuple[str, str] | None:
    """The unit in which stamps are dates at a rate that sensors have, where they are neither in the
    one that is stated; with its sentence."""
    if date_of(first, unit) is not None or 1.0 / (step * TIME_UNITS[unit]) <= _FASTEST_USUAL:
        return None
    for other in ("s", "ms", "us", "ns"):
        rate = 1.0 / (step * TIME_UNITS[other])
        if SLOWEST <= rate <= _FASTEST_USUAL and date_of(first, other) is not None:
            said = f"{who} states {unit}, in which they are no dates and advance too fast"
            return other, f"time: the stamps are dates in {other} ({rate:.6g} Hz); {said}"
    return None


def seconds_of(
    stamps: NDArray[Any], origin: float | int, unit: str, missing: int | None = None
) -> Array:
    """Seconds since the stamp `origin`, exact before the last rounding; NaN for `missing`."""
    size = TIME_UNITS.get(unit, 1e-9)
    if stamps.dtype.kind not in "iu":
        return np.asarray((stamps.astype(np.float64) - origin) * size)
    whole = stamps.astype(np.int64) - int(origin)
    seconds = np.asarray(whole * size if size >= 1.0 else whole / round(1.0 / size), np.float64)
    if missing is not None:
        seconds[stamps == missing] = np.nan
    return seconds


def date_of(stamp: float | int, unit: str, epoch: int | None = None) -> int | None:
    """Nanoseconds since 1970 of a stamp, or None where it is no date.

    epoch : the date of stamp zero in the same, where the file states it
    """
    if unit in TIME_ZEROS:
        epoch = TIME_ZEROS[unit] * 1_000_000_000
    size = Fraction(TIME_UNITS.get(unit, 1e-9)).limit_denominator(10**9)
    ns = round(Fraction(stamp) * size * 10**9)
    if epoch is not None:
        return ns + epoch if abs(ns + epoch) < 2**63 else None
    return ns if is_absolute(ns * 1e-9) else None


def clock_unit(text: str, where: str) -> tuple[str, int | None]:
    """Unit and origin (ns since 1970) of "milliseconds since 2020-01-01 12:00", else the text in
    its usual spelling.

    The form is that of netCDF (CF Conventions, 4.4); an origin without a zone is UTC there.
    Raises UnreadableInput for an origin that is no date.
    """
    found = _SINCE.match(text)
    word = (found[1] if found else text).strip()
    unit = word if word in TIME_UNITS else _ALIASES.get(word.lower(), word.lower())
    unit = unit if unit in TIME_UNITS else word
    if not found:
        return unit, None
    try:
        start = datetime.fromisoformat(_pad_date(found[2].removesuffix("UTC").strip()))
    except ValueError:
        raise UnreadableInput(
            f"the clock counts from '{found[2][:40]}', which is no date",
            where=where,
            remedy="name the unit with --time-unit: it then counts from the first sample",
        ) from None
    start = start if start.tzinfo else start.replace(tzinfo=UTC)
    since = start - _EPOCH
    return unit, (since.days * 86_400_000_000 + since.seconds * 10**6 + since.microseconds) * 1000


def _pad_date(text: str) -> str:
    """The date with two digits where one is written: "2020-1-1 0:0:0" is common."""
    return re.sub(r"(?<![\d.])(\d)(?!\d)", r"0\1", text)
