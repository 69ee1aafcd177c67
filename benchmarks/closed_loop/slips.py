"""Slips of the hand in a bench's sheet, and the repair that undoes each."""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np
from defects import Array, direction

KINDS = (
    "exchanged rows",
    "lost sign",
    "factor ten",
    "mistyped inclination",
    "mistyped tool-face",
    "exchanged cells",
    "copied row",
)
_AXES = "xyz"
#: Share by which a repair's value may differ: sheets are rounded.
_CLOSE = 1e-3


def slipped(rng: np.random.Generator, kind: str, dial: Array, noted: Array) -> tuple[str, ...]:
    """Make the slip in the sheet, in place; returns the repairs in the command's words ("10:y=-4",
    "swap 3,4"), or "row 7" where nothing in the sheet restores it."""
    row = int(rng.integers(len(dial)))
    if kind in ("exchanged rows", "copied row"):
        return _rows(rng, kind, dial, noted, row)
    if kind.startswith("mistyped"):
        k = int(kind.endswith("tool-face"))
        if k:  # where the tool-face means something
            row = int(rng.choice(np.flatnonzero(np.abs(dial[:, 0]) < 75)))
        grid = np.unique(dial[:, k])
        right = dial[row, k]
        at = int(np.searchsorted(grid, right))
        near = [j for j in (at - 1, at + 1) if 0 <= j < len(grid)]
        dial[row, k] = grid[rng.choice(near)]
        return (f"{row + 1}:{('inclination', 'tool_face')[k]}={right:.10g}",)
    if kind == "exchanged cells":
        apart = np.flatnonzero(np.abs(noted[:, 0] - noted[:, 1]) > 150)
        row = int(rng.choice(apart))
        right = noted[row].copy()
        noted[row, :2] = right[1::-1]
        return tuple(f"{row + 1}:{_AXES[k]}={right[k]:.10g}" for k in (0, 1))
    axis = int(np.argmax(np.abs(noted[row])))
    right = noted[row, axis]
    noted[row, axis] = -right if kind == "lost sign" else right * rng.choice([0.1, 10.0])
    return (f"{row + 1}:{_AXES[axis]}={right:.10g}",)


def _rows(
    rng: np.random.Generator, kind: str, dial: Array, noted: Array, row: int
) -> tuple[str, ...]:
    force = direction(*dial.T)
    if kind == "copied row":
        row = max(row, 1)
        noted[row] = noted[row - 1]
        return (f"row {row + 1}",)
    far = np.flatnonzero(force @ force[row] < np.cos(np.deg2rad(15.0)))
    other = int(rng.choice(far))
    noted[[row, other]] = noted[[other, row]]
    return (f"swap {min(row, other) + 1},{max(row, other) + 1}",)


def repairs(lines: Iterable[str]) -> set[str]:
    """Every repair that lines of a report give, in the words of `slipped`."""
    found = set()
    for line in lines:
        for cells in re.findall(r"--fix (\S+)", line):
            found.add(cells.rstrip(",.;)"))
        for a, b in re.findall(r"--swap (\d+),(\d+)", line):
            found.add(f"swap {min(int(a), int(b))},{max(int(a), int(b))}")
    return found


def rows_of(lines: Iterable[str]) -> set[int]:
    """Rows that lines speak of."""
    return {int(n) for line in lines for n in re.findall(r"\brows? (\d+)", line)}


def accuses(lines: Iterable[str]) -> bool:
    """Whether a record is said to be wrong."""
    return any(f"--{way}" in line for line in lines for way in ("fix", "swap", "exclude"))


def repaired(planted: tuple[str, ...], lines: list[str]) -> bool:
    """Whether the lines hold every planted repair; a row that none restores has to be named."""
    given = repairs(lines)
    for one in planted:
        if one.startswith("row "):
            if int(one[4:]) not in rows_of(lines):
                return False
        elif not any(_same(one, other) for other in given):
            return False
    return True


def _same(one: str, other: str) -> bool:
    if "=" not in one or "=" not in other:
        return one == other
    (cell, value), (mine, told) = one.split("="), other.split("=")
    try:
        return cell == mine and abs(float(told) - float(value)) <= _CLOSE * max(
            1, abs(float(value))
        )
    except ValueError:
        return False
