"""A change of range or unit within a recording: gravity of one size before, of another after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.units import STANDARD_GRAVITY

_RATIO = 1.3  # between two sizes of gravity that no sensor's errors explain
_CLEARER = 5.0  # times that two levels leave less scatter than one: a steady drift leaves a quarter
_FEWEST = 5  # windows on either side


@dataclass(frozen=True)
class Ranges:
    """row : of the first window after the change; before, after : median size there"""

    row: int
    before: float
    after: float


def two_ranges(size: Array) -> Ranges | None:
    """The two ranges of sizes (n,) in order of time; None where one does.

    One split by least squares of the logarithm: a range is a factor.
    """
    n = size.size
    if n < 2 * _FEWEST or not np.all(size > 0.0):
        return None
    x = np.log(size)
    x = x - x.mean()
    rows = np.arange(_FEWEST, n - _FEWEST + 1)
    total = np.cumsum(x)[rows - 1]
    explained = total**2 / rows + total**2 / (n - rows)
    best = int(np.argmax(explained))
    row, left = int(rows[best]), float(np.sum(x**2) - explained[best])
    before, after = float(np.median(size[:row])), float(np.median(size[row:]))
    far = max(before, after) > _RATIO * min(before, after)
    return Ranges(row, before, after) if far and _CLEARER * left < float(np.sum(x**2)) else None


def refuse_two_ranges(start: Array, mean: Array, path: str) -> None:
    """Raises UnreadableInput where windows that start at times (m,) s read (m, 3) m/s² in two
    ranges. All are asked: with the range the noise changes, and one part is not still."""
    change = two_ranges(np.linalg.norm(mean, axis=1))
    if change is None:
        return
    before, after = (level / STANDARD_GRAVITY for level in (change.before, change.after))
    raise UnreadableInput(
        f"gravity is {before:.3g} g before {start[change.row] / 3600.0:.2f} h and {after:.3g} g "
        "from there on: the range or the unit changes",
        where=path,
        remedy="export it in two files at that moment, each with its own scale, or one for all",
    )
