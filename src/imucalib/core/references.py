"""What is known of the truth in each observation, and the free directions η of what is not.

A reference gives the specific force `truth(eta)` (n, K, 3) in m/s² in the tool's frame and
its derivative along the free directions. A direction with a named component has a Gaussian prior
whose standard deviation is estimated (a bench's setting errors); a direction without one is flat
and is projected out of every observation (an unknown attitude, an unknown motion).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imucalib.arrays import Array, Index


@dataclass(frozen=True)
class Directions:
    """Free directions at one η.

    derivative : (n, K, 3, q) of the truth (m/s² per unit of η)
    index : (n, q) which entry of η each local direction is; shared settings share an entry
    component : per local direction, the name of its variance component, or None when flat
    """

    derivative: Array
    index: Index
    component: tuple[str | None, ...]


class Reference(Protocol):
    """The contract of a reference; `eta` is one flat vector of `eta_size` numbers."""

    @property
    def n(self) -> int: ...
    @property
    def eta_size(self) -> int: ...
    @property
    def directed(self) -> bool:
        """Whether the truth at η = 0 is what was meant, or its direction is unknown."""
        ...

    def truth(self, eta: Array) -> Array:
        """(n, K, 3) specific force in m/s² at η."""
        ...

    def directions(self, eta: Array) -> Directions: ...

    def start(self, corrected: Array) -> Array:
        """η to start from, given readings (n, K, 3) corrected by the starting model."""
        ...

    def move(self, eta: Array, step: Array) -> Array:
        """η after a tangent step (radians for directions)."""
        ...

    def take(self, rows: Index) -> Reference: ...


def unit_vector(inclination: Array, tool_face: Array) -> Array:
    """Direction (n, 3) from inclination and tool-face in rad.

    u = (cos i sin t, cos i cos t, sin i): tool-face runs from +y towards +x, inclination 0 has z
    horizontal. Paper 004, formulae (1) and (2), p. 2, stated on vectors so that angles beyond 90
    degrees need no case distinction.
    """
    c = np.cos(inclination)
    return np.stack([c * np.sin(tool_face), c * np.cos(tool_face), np.sin(inclination)], axis=-1)


def angles_of(vector: Array) -> tuple[Array, Array]:
    """Inclination in [-π/2, π/2] and tool-face in [0, 2π) of vectors (..., 3), both in rad."""
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    return np.arctan2(z, np.hypot(x, y)), np.mod(np.arctan2(x, y), 2.0 * np.pi)


def angle_slopes(vector: Array) -> Array:
    """(2, n, 3) rad by the components of vectors (n, 3), of inclination and tool-face: formulae (1)
    and (2) of paper 004, p. 2, differentiated,

    δ tool-face = (a_y δa_x - a_x δa_y) / (a_x² + a_y²)
    δ inclination = (h δa_z - a_z (a_x δa_x + a_y δa_y) / h) / |a|²,   h² = a_x² + a_y²
    """
    x, y, z = vector.T
    h = np.maximum(np.hypot(x, y), 1e-12)
    inclination = np.stack([-z * x / h, -z * y / h, h], axis=-1)
    tool_face = np.stack([y, -x, np.zeros_like(x)], axis=-1)
    square = np.stack([np.sum(vector**2, axis=1), h**2])
    return np.asarray(np.stack([inclination, tool_face]) / square[..., None])


def tangents(direction: Array) -> Array:
    """(n, 3, 2) two unit vectors square to each unit vector (n, 3) and to each other."""
    # The axis that is least along it gives a well-conditioned frame everywhere on the sphere.
    axis = np.eye(3)[np.argmin(np.abs(direction), axis=1)]
    first = np.cross(direction, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(direction, first)], axis=-1)


@dataclass(frozen=True)
class KnownVector:
    """Gravity of known size in a direction set by hand on a table: the lab's reference.

    inclination, tool_face : (n,) rad, as set
    gravity : m/s²
    inclination_setting, tool_face_setting : (n,) id of the setting of each row; rows between
        which the axis was not touched share an id, hence share the setting's error
    setting_errors : False takes the angles as exact (the plain vector least squares)
    """

    inclination: Array
    tool_face: Array
    gravity: float
    inclination_setting: Index
    tool_face_setting: Index
    setting_errors: bool = True

    COMPONENTS = ("inclination setting", "tool-face setting")
    directed = True

    @property
    def n(self) -> int:
        return len(self.inclination)

    @property
    def _inclinations(self) -> int:
        return int(self.inclination_setting.max(initial=-1)) + 1

    @property
    def eta_size(self) -> int:
        return self._inclinations + int(self.tool_face_setting.max(initial=-1)) + 1

    def _set_angles(self, eta: Array) -> tuple[Array, Array]:
        split = self._inclinations
        return (
            self.inclination + eta[:split][self.inclination_setting],
            self.tool_face + eta[split:][self.tool_face_setting],
        )

    def truth(self, eta: Array) -> Array:
        return self.gravity * unit_vector(*self._set_angles(eta))[:, None, :]

    def directions(self, eta: Array) -> Directions:
        if not self.setting_errors:
            return Directions(np.zeros((self.n, 1, 3, 0)), np.zeros((self.n, 0), np.intp), ())
        i, t = self._set_angles(eta)
        along_i = unit_vector(i + np.pi / 2.0, t)
        along_t = np.stack([np.cos(i) * np.cos(t), -np.cos(i) * np.sin(t), np.zeros_like(i)], -1)
        derivative = self.gravity * np.stack([along_i, along_t], axis=-1)[:, None]
        index = np.stack(
            [self.inclination_setting, self.tool_face_setting + self._inclinations], axis=-1
        )
        return Directions(derivative, index, self.COMPONENTS)

    def start(self, corrected: Array) -> Array:
        del corrected
        return np.zeros(self.eta_size)

    def move(self, eta: Array, step: Array) -> Array:
        return eta + step

    def take(self, rows: Index) -> KnownVector:
        def renumber(ids: Index) -> Index:
            return np.unique(ids[rows], return_inverse=True)[1].astype(np.intp)

        return KnownVector(
            self.inclination[rows],
            self.tool_face[rows],
            self.gravity,
            renumber(self.inclination_setting),
            renumber(self.tool_face_setting),
            self.setting_errors,
        )


@dataclass(frozen=True)
class KnownNorm:
    """Gravity of known size in an unknown direction: all that sensors at rest always have.

    η is a unit vector per observation, stored as (n * 3,); its free directions are the two
    tangents, without a prior. The calibration is determined up to a rotation of the frame.

    attitude : (K, 3, 3) from each triad's axes to the common ones, of K triads on one rigid body,
        which share the direction; None for a single triad
    """

    count: int
    gravity: float
    attitude: Array | None = None

    directed = False

    @property
    def n(self) -> int:
        return self.count

    @property
    def eta_size(self) -> int:
        return 2 * self.count

    def truth(self, eta: Array) -> Array:
        return self.gravity * self._turn_to_triads(eta.reshape(self.count, 3, 1))[..., 0]

    def _turn_to_triads(self, columns: Array) -> Array:
        """(n, K, 3, m) in each triad's axes, of columns (n, 3, m) in the common ones."""
        if self.attitude is None:
            return columns[:, None]
        return np.asarray(self.attitude.transpose(0, 2, 1) @ columns[:, None])

    def _tangents(self, eta: Array) -> Array:
        return tangents(eta.reshape(self.count, 3))

    def directions(self, eta: Array) -> Directions:
        derivative = self.gravity * self._turn_to_triads(self._tangents(eta))
        index = np.arange(2 * self.count, dtype=np.intp).reshape(self.count, 2)
        return Directions(derivative, index, (None, None))

    def start(self, corrected: Array) -> Array:
        d = corrected[:, 0]
        if self.attitude is not None:
            d = np.einsum("kij,nkj->ni", self.attitude, corrected)
        return np.asarray((d / np.linalg.norm(d, axis=1, keepdims=True)).ravel())

    def move(self, eta: Array, step: Array) -> Array:
        d = eta.reshape(self.count, 3)
        moved = d + np.einsum("nij,nj->ni", self._tangents(eta), step.reshape(self.count, 2))
        return np.asarray((moved / np.linalg.norm(moved, axis=1, keepdims=True)).ravel())

    def take(self, rows: Index) -> KnownNorm:
        return KnownNorm(len(rows), self.gravity, self.attitude)
