"""Directions on the sphere: evenly spread ones, and one that was set without dials.

On a fixture with known normals a tilt in every direction exists at any attitude. The two angles of
`KnownVector` do not give that: with z vertical a tool-face turns about gravity itself and tilts
nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.references import Directions, tangents

#: Up to this tilt (rad) the direction is turned; beyond it moves on straight. No fixture is so far
#: off, and a record of a wrong face or sign must not be explained by a tilt half round the sphere.
_LARGEST = 0.2
#: Cells of the sphere in which postures are counted.
CELLS = 96


@dataclass(frozen=True)
class KnownDirection:
    """Gravity of known size in a direction that is known up to a small tilt.

    direction : (n, 3) unit vectors as meant; gravity : m/s²
    tilts : False takes the directions as exact

    η holds two tilts (rad) a row, along the two `tangents` of its direction: the truth is the
    direction turned by the length of the tilt. All have one estimated standard deviation, and every
    row is set anew.
    """

    direction: Array
    gravity: float
    tilts: bool = True

    COMPONENTS = ("tilt", "tilt")
    directed = True

    @property
    def n(self) -> int:
        return len(self.direction)

    @property
    def eta_size(self) -> int:
        return 2 * self.n * self.tilts

    def truth(self, eta: Array) -> Array:
        if not self.tilts:
            return self.gravity * self.direction[:, None]
        along, across, _, _ = self._turn(eta)
        turned = along[:, None] * self.direction + across[:, None] * self._away(eta)
        return np.asarray(self.gravity * turned[:, None])

    def _away(self, eta: Array) -> Array:
        """(n, 3) the tilt as a vector square to the direction, rad."""
        away = np.einsum("nij,nj->ni", tangents(self.direction), eta.reshape(self.n, 2))
        return np.asarray(away)

    def _turn(self, eta: Array) -> tuple[Array, Array, Array, Array]:
        """Parts (n,) along the direction and along the tilt vector, and their slopes by half the
        square of the tilt's length r: cos r, sin r / r, up to `_LARGEST`, then a straight line."""
        r = np.linalg.norm(eta.reshape(self.n, 2), axis=1)
        near, beyond = np.minimum(r, _LARGEST), np.maximum(r - _LARGEST, 0.0)
        safe = np.maximum(r, 1e-3)
        cosine, sine = np.cos(near), np.sin(near)
        along, across = cosine - sine * beyond, np.sinc(near / np.pi)
        across = np.where(beyond > 0.0, (sine + cosine * beyond) / safe, across)
        along_slope = np.where(r < 1e-3, -1.0, -sine / safe)
        across_slope = np.where(r < 1e-3, -1.0 / 3.0, (cosine - across) / safe**2)
        return along, across, along_slope, across_slope

    def directions(self, eta: Array) -> Directions:
        if not self.tilts:
            return Directions(np.zeros((self.n, 1, 3, 0)), np.zeros((self.n, 0), np.intp), ())
        _, across, along_slope, across_slope = self._turn(eta)
        tilt = eta.reshape(self.n, 1, 2)
        bend = along_slope[:, None] * self.direction + across_slope[:, None] * self._away(eta)
        slope = across[:, None, None] * tangents(self.direction) + bend[:, :, None] * tilt
        index = np.arange(2 * self.n, dtype=np.intp).reshape(self.n, 2)
        return Directions(self.gravity * slope[:, None], index, self.COMPONENTS)

    def start(self, corrected: Array) -> Array:
        del corrected
        return np.zeros(self.eta_size)

    def move(self, eta: Array, step: Array) -> Array:
        return eta + step

    def take(self, rows: Index) -> KnownDirection:
        return KnownDirection(self.direction[rows], self.gravity, self.tilts)


def count_by_cell(directions: Array) -> Index:
    """(CELLS,) how many of the vectors (n, 3) point into each cell of the sphere."""
    return np.bincount(cell_of(directions), minlength=CELLS)


def cell_of(directions: Array) -> Index:
    """(n,) the cell that each vector (n, 3) points into: the nearest of CELLS even directions."""
    return np.asarray(np.argmax(directions @ even_directions(CELLS).T, axis=1), np.intp)


def coverage(directions: Array) -> float:
    """Share of the sphere within 30 deg of one of the vectors (n, 3)."""
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    nearest = (even_directions() @ unit.T).max(axis=1)
    return float(np.mean(nearest >= np.cos(np.radians(30.0))))


def even_directions(n: int = 400) -> Array:
    """(n, 3) unit vectors spread evenly: one in each of n equal areas from pole to pole, turned by
    the golden section from one to the next (Swinbank and Purser 2006)."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    r = np.sqrt(1.0 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1)
