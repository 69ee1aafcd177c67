"""What one block of rows hands to the next, and the times of a block that depend on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.readers.csv.clock import bad_stamp
from imucalib.readers.csv.parse import Rows
from imucalib.readers.csv.plan import Plan
from imucalib.readers.csv.time import spread


@dataclass
class Position:
    """What one block hands to the next; moved : s that stamps without a date have been moved on;
    bad_rows : left out, first_bad : why and where."""

    row: int = 0
    last: dict[str, float] = field(default_factory=dict)
    moved: float = 0.0
    last_of_period: float = -np.inf
    held: tuple[Array, Array] | None = None
    first_group: bool = True
    idle_rows: int = 0
    missing_rows: int = 0
    bad_rows: int = 0
    first_bad: str = ""


def count_bad(rows: Rows, position: Position, where: str) -> None:
    """Count the rows that were left out, and keep the reason of the first."""
    if rows.bad and not position.bad_rows:
        first = rows.bad[0]
        position.first_bad = f"{first.where.removeprefix(where).lstrip(': ')}: {first.what}"
    position.bad_rows += len(rows.bad)


def times_of(
    rows: Rows, plan: Plan, position: Position, line: int, where: str
) -> tuple[Array, Rows]:
    """Seconds of the rows, and the rows whose stamps are understood."""
    clock = plan.clock
    if not clock.kind:
        count = rows.values.shape[0]
        return (position.row + np.arange(count, dtype=np.float64)) / clock.rate, rows
    t, wrong = clock.seconds(rows.stamps)
    if wrong.any():
        t, rows = t[~wrong], _without(rows, wrong, line, where)
    if clock.text is None or clock.text.dated or t.size == 0:
        return t, rows
    period, known = clock.text.period, np.isfinite(t)
    back = np.zeros(t.shape, dtype=np.bool_)
    back[known] = np.diff(t[known], prepend=position.last_of_period) < -period / 2
    if known.any():
        position.last_of_period = float(t[known][-1])
    moved = position.moved + period * np.cumsum(back)
    position.moved = float(moved[-1])
    return np.asarray(t + moved), rows


def _without(rows: Rows, wrong: NDArray[np.bool_], line: int, where: str) -> Rows:
    """The rows without those whose stamps are not understood; raises when those are most."""
    at = np.flatnonzero(wrong)
    bad = [bad_stamp(rows, int(k), line, where) for k in at]
    if 2 * at.size > wrong.size:
        raise bad[0]
    lines = rows.lines[~wrong] if rows.lines is not None else None
    return Rows(rows.stamps[~wrong], rows.values[~wrong], (*rows.bad, *bad), lines)


def spread_stamps(
    t: Array, values: Array, plan: Plan, position: Position, *, flush: bool
) -> tuple[Array, Array]:
    """Coarse stamps spread; the last group waits for the next block, where it may go on."""
    if position.held is not None:
        t = np.concatenate([position.held[0], t])
        values = np.concatenate([position.held[1], values])
        position.held = None
    if t.size == 0:
        return t, values
    if not flush:
        changes = np.flatnonzero(np.diff(t) != 0)
        cut = int(changes[-1]) + 1 if changes.size else 0
        position.held = (t[cut:], values[cut:])
        t, values = t[:cut], values[:cut]
    if t.size:
        clock = plan.clock
        moved = spread(t, clock.resolution, clock.typical, position.first_group)
        position.first_group = False
        t = t + moved
    return t, values
