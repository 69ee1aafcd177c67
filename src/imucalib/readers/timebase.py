"""The clock of a recording: step, unit, and where it has gaps. Nothing here moves a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.recording.mapping import TIME_UNITS
from imucalib.recording.recording import Gap

_YEAR_2000, _YEAR_2100 = 946_684_800.0, 4_102_444_800.0
_MISSING_ONE = 1.75  # a step of two periods is a lost sample when the clock is clean
SIDES, _FEWEST = 9, 3  # samples on each side of a step back that decide whether it is one
_JITTERY = 5.0  # else only a step of this many times its 99th percentile is a gap


@dataclass(frozen=True)
class Stepping:
    """step : median positive step, s; threshold : a longer step is a gap, s."""

    step: float
    threshold: float


def stepping(pieces: Sequence[Array]) -> Stepping | None:
    """Step statistics of pieces of consecutive times (s); None when no time ever advances."""
    steps = np.concatenate([np.diff(t) for t in pieces]) if pieces else np.empty(0)
    steps = steps[np.isfinite(steps) & (steps > 0)]
    if steps.size == 0:
        return None
    step = float(np.median(steps))
    high = float(np.percentile(steps, 99))
    return Stepping(step, max(_MISSING_ONE * step, _JITTERY * high if high > 1.5 * step else 0.0))


def find_gaps(t: Array, rows: Array | range, threshold: float, before: float | None) -> list[Gap]:
    """Gaps and back-steps of the times of one channel (s).

    rows : number of each sample's row in the file, to tell missing values from missing rows;
    before : the last time of the previous block, or None.
    """
    gaps = []

    def add(start: float, stop: float, lost: bool) -> None:
        reason = "time steps back" if stop < start else "values missing" if lost else "no samples"
        gaps.append(Gap(start, stop, reason))

    if before is not None and t.size and not 0.0 <= float(t[0]) - before <= threshold:
        add(before, float(t[0]), False)
    steps = np.diff(t)
    if steps.size and not (steps.min() >= 0.0 and steps.max() <= threshold):
        for k in np.flatnonzero((steps > threshold) | (steps < 0)).tolist():
            add(float(t[k]), float(t[k + 1]), int(rows[k + 1] - rows[k]) > 1)
    return gaps


def set_back(t: NDArray[Any], before: NDArray[Any], least: float) -> list[int]:
    """Rows of `t` at which its clock was set back by more than `least`.

    before : the last `SIDES` times in front of `t`, or fewer. A step back counts where most samples
    of both sides agree: one stamp that is wrong or late sets no clock.
    """
    whole = np.concatenate([before, t])
    rows, last = list[int](), 0
    for row in (np.flatnonzero(whole[1:] < whole[:-1] - least) + 1).tolist():
        one, other = whole[max(last, row - SIDES) : row], whole[row : row + SIDES]
        if min(one.size, other.size) >= _FEWEST and row >= before.size and (
            np.median(other) < np.median(one) - least
        ):  # fmt: skip
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


def guess_unit(first: float, step: float, where: str) -> tuple[str, str]:
    """The unit of numeric time stamps from their size and step, with the sentence that says why.

    Raises UnreadableInput when more than one unit, or none, gives a rate of 5 to 8000 Hz, or when
    the numbers may be a counter.
    """
    for unit in ("s", "ms", "us", "ns"):
        size = TIME_UNITS[unit]
        if is_absolute(first * size) and 0.01 <= 1.0 / (step * size) <= 20_000.0:
            return unit, f"time: {first:.16g} is a date when the unit is {unit}"
    if step < 1.0:
        return "s", f"time: a median step of {step:.6g} -> unit s"
    fitting = [u for u in ("s", "ms", "us", "ns") if 5.0 <= 1.0 / (step * TIME_UNITS[u]) <= 8000.0]
    if len(fitting) == 1 and step != 1.0:  # steps of one may be a counter
        rate = 1.0 / (step * TIME_UNITS[fitting[0]])
        sentence = f"time: a median step of {step:.6g} -> unit {fitting[0]} ({rate:.6g} Hz)"
        return fitting[0], sentence
    raise UnreadableInput(
        f"the unit of the time stamps is unclear: their median step is {step:.6g}",
        where=where,
        remedy="name it with --time-unit, or give --rate",
    )
