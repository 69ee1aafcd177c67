"""What one block of rows hands to the next, and the times of a block that depend on it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.csv.clock import bad_stamp
from imucalib.readers.csv.parse import Rows
from imucalib.readers.csv.plan import Plan
from imucalib.readers.csv.time import spread

_DAY = 86_400.0
_MOST_BAD_STAMPS = 1000  # of a block: each costs a pass over it


@dataclass
class Position:
    """What one block hands to the next; bad_rows : left out, first_bad : why and where."""

    row: int = 0
    last: dict[str, float] = field(default_factory=dict)
    days: float = 0.0
    last_of_day: float = -np.inf
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
    while True:
        try:
            t = clock.seconds(rows.stamps)
            break
        except ValueError as error:
            rows = _without_bad_stamp(rows, bad_stamp(rows, error, line, where), error)
    if clock.text is None or clock.text.dated or t.size == 0:
        return t, rows
    back = np.diff(t, prepend=position.last_of_day) < -_DAY / 2
    position.last_of_day = float(t[-1])
    days = position.days + _DAY * np.cumsum(back)
    position.days = float(days[-1])
    return np.asarray(t + days), rows


def _without_bad_stamp(rows: Rows, why: UnreadableInput, error: ValueError) -> Rows:
    """The rows without the one whose stamp is not understood; raises when those are many."""
    if len(rows.bad) >= min(_MOST_BAD_STAMPS, rows.stamps.size // 2):
        raise why from error
    index = int(error.args[0]) if error.args and isinstance(error.args[0], int) else 0
    lines = np.delete(rows.lines, index) if rows.lines is not None else None
    stamps, values = np.delete(rows.stamps, index), np.delete(rows.values, index, axis=0)
    return Rows(stamps, values, (*rows.bad, why), lines)


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
