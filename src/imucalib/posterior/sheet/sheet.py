"""A bench's sheet as numbers, what a fault of it is, and the line that repairs it."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.references import unit_vector
from imucalib.posterior.odds import SHUFFLES
from imucalib.question import Question
from imucalib.significant_digits import per_cent

Kind = Literal[
    "exchange", "move", "shift", "cell", "angle", "setting", "axes", "convention", "record"
]
#: Dial angles (deg) to inclination and tool-face in rad, each angle on its own.
Inside = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Fault:
    """One slip of hand.

    what : the sentence; rows : numbers of the sheet's rows that it touches, none for the whole
    score : nats beyond the sheet as it stands, at first glance
    line : options of `imucal lab` that repair it; probability : that it is so, where it was solved
    rivals : lines that explain the sheet as well, within 5 nats
    cells : of a wrong cell, each column and the value that it should hold, in the sheet's unit
    """

    kind: Kind
    what: str
    rows: tuple[int, ...]
    score: float
    line: str
    rivals: tuple[str, ...] = ()
    cells: tuple[tuple[str, float], ...] = ()
    probability: float = math.nan

    @property
    def where(self) -> str:
        """The rows in words."""
        first, last = self.rows[0], self.rows[-1]
        return f"row {first}" if first == last else f"rows {first} to {last}"

    @property
    def question(self) -> Question:
        """What, how likely, and what to paste."""
        sure = "" if math.isnan(self.probability) else f" ({per_cent(self.probability)})"
        options = tuple(shlex.split(self.line))
        return Question(f"{self.what}{sure}", options, "; ".join(self.rivals))


@dataclass(frozen=True)
class Trial:
    """A fault that is tried, and the sheet that its repair would give, None where a record is set
    aside; its score is what it gains at first glance, with `prior`, the log odds of its class and
    place."""

    fault: Fault
    repaired: Sheet | None
    prior: float


@dataclass(frozen=True)
class Sheet:
    """The rows of a table that are judged.

    reading : (n, 3) mg; inclination, tool_face : (n,) deg, as on the sheet; row : (n,) its numbers
    place : (n,) where each stands in the whole table, from 0
    gravity : mg; inclination_setting, tool_face_setting : (n,) id of the setting of each row
    inside : the convention of the angles; ordered : the rows stand in the order of the work
    """

    reading: Array
    inclination: Array
    tool_face: Array
    row: Index
    place: Index
    gravity: float
    inclination_setting: Index
    tool_face_setting: Index
    inside: Inside
    ordered: bool

    @property
    def n(self) -> int:
        return len(self.row)

    def angles(self) -> tuple[Array, Array]:
        """Inclination and tool-face (n,) in rad."""
        return self.inside(self.inclination, self.tool_face)

    def truth(self) -> Array:
        """(n, 3) mg, what a perfect sensor would read."""
        return self.gravity * unit_vector(*self.angles())

    def with_reading(self, reading: Array) -> Sheet:
        return replace(self, reading=reading)

    def take(self, rows: Index) -> Sheet:
        """Some of the rows."""
        every = vars(self).items()
        columns: dict[str, Any] = {n: v[rows] for n, v in every if isinstance(v, np.ndarray)}
        return replace(self, **columns)

    def find_copies(self) -> NDArray[np.bool_]:
        """(n,) whether another row has exactly the same three readings: a copy, not a slip."""
        _, which, count = np.unique(self.reading, axis=0, return_inverse=True, return_counts=True)
        return np.asarray(count[which.ravel()] > 1)

    def runs(self) -> Index:
        """(n,) number of each row's run of neighbours in the table, none of which is left out."""
        return np.concatenate([[0], np.cumsum(np.diff(self.place) != 1)])


def in_order(inclination: Array, tool_face: Array) -> bool:
    """Whether the way from row to row is shorter than in shuffled rows (p = 0.005): then the rows
    stand in the order in which a bench is worked. Angles in rad; the shuffles are fixed."""
    u = unit_vector(inclination, tool_face)

    def way(rows: Index) -> float:
        return float(np.linalg.norm(np.diff(u[rows], axis=0), axis=1).sum())

    rng = np.random.default_rng(0)
    shuffled = min(way(rng.permutation(len(u))) for _ in range(SHUFFLES))
    return way(np.arange(len(u))) < shuffled
