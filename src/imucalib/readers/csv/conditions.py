"""Rows of a text table that are asked for by the value of a column, and columns that could ask."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from imucalib.errors import UnreadableInput
from imucalib.readers.csv.dialect import is_number

#: Values that a column may take to be told: more are no sensors, tools or sessions of one file.
_FEW = 12
#: Words of headings whose numbers are names.
_NAMES = {"serial", "id", "tool", "device", "sensor", "subject", "tag", "session", "tagid"}


@dataclass(frozen=True)
class Condition:
    """column : from 0; value : as it stands in the cells, or another spelling of the number"""

    column: int
    value: str

    def fits(self, cell: str) -> bool:
        """Whether a cell holds the value."""
        if cell == self.value:
            return True
        return is_number(cell) and is_number(self.value) and float(cell) == float(self.value)


def parted(condition: str) -> tuple[str, str]:
    """Column and value of "serial=A12"."""
    column, _, value = condition.partition("=")
    return column.strip(), value.strip()


def demand_some(
    kept: int, conditions: Sequence[str], cells: Sequence[Sequence[str]], where: str
) -> None:
    """Raise UnreadableInput where no row is left. cells : of each condition's column"""
    if kept:
        return
    there = [
        f"{parted(c)[0]} is {_listed(Counter(v))}" for c, v in zip(conditions, cells, strict=True)
    ]
    raise UnreadableInput(
        f"no row has {' and '.join(conditions)}", where=where,
        remedy=f"choose what is there with --where: {'; '.join(there)}",
    )  # fmt: skip


def told(name: str, cells: Sequence[str]) -> str:
    """What is said of a column that takes a few values of words or names, or ""."""
    found = Counter(cell for cell in cells if cell)
    words = not all(is_number(cell) for cell in found)
    named = bool(set(name.lower().replace("-", "_").replace(" ", "_").split("_")) & _NAMES)
    if not 2 <= len(found) <= _FEW or not (words or named):
        return ""
    first = next(iter(found))
    return f"column '{name}' is {_listed(found)} (--where '{name}={first}' reads those rows alone)"


def _listed(found: Counter[str]) -> str:
    """Values and how often they occur."""
    shown = ", ".join(f"{value or 'empty'} ({n} rows)" for value, n in list(found.items())[:_FEW])
    return shown + (", ..." if len(found) > _FEW else "")
