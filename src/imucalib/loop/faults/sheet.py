"""A bench's sheet as numbers: what was read, what was set, and in which order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.references import unit_vector

#: Dial angles (deg) to inclination and tool-face in rad, each angle on its own.
Inside = Callable[[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True)
class Sheet:
    """The rows of a table that are judged.

    reading : (n, 3) mg; inclination, tool_face : (n,) deg, as on the sheet; row : (n,) its numbers
    place : (n,) where each stands in the whole table, from 0
    sigma : (n,) noise of a row relative to the others; gravity : mg
    inclination_setting, tool_face_setting : (n,) id of the setting of each row
    inside : the convention of the angles; ordered : the rows stand in the order of the work
    """

    reading: Array
    inclination: Array
    tool_face: Array
    row: Index
    place: Index
    sigma: Array
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
        columns = {
            name: getattr(self, name)[rows]
            for name in (
                "reading", "inclination", "tool_face", "row", "place", "sigma",
                "inclination_setting", "tool_face_setting",
            )
        }  # fmt: skip
        return replace(self, **columns)

    def copied(self) -> NDArray[np.bool_]:
        """(n,) whether another row has exactly the same three readings: a copy, not a slip."""
        _, which, count = np.unique(self.reading, axis=0, return_inverse=True, return_counts=True)
        return np.asarray(count[which.ravel()] > 1)

    def beside(self) -> Index:
        """(n - 1,) 1 where no row of the table is left out between two neighbours, else 0."""
        return np.asarray(np.diff(self.place) == 1, np.intp)


def in_order(inclination: Array, tool_face: Array, draws: int = 199) -> bool:
    """Whether the way from row to row is shorter than in shuffled rows (p = 0.005): then the rows
    stand in the order in which a bench is worked. Angles in rad; the shuffles are fixed."""
    u = unit_vector(inclination, tool_face)

    def way(rows: Index) -> float:
        return float(np.linalg.norm(np.diff(u[rows], axis=0), axis=1).sum())

    rng = np.random.default_rng(0)
    shuffled = min(way(rng.permutation(len(u))) for _ in range(draws))
    return way(np.arange(len(u))) < shuffled
