"""A calibrated sensor as it acts: readings of a force, the force of a reading, and how both move
with the calibration's parameters. The same for a single accelerometer and for an IMU of an array.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.linearised import Acting, acting
from imucalib.calibration.triads import Triad
from imucalib.core.context import Context


class CalibratedSensor(Protocol):
    """Vectors are (n, 3) m/s²."""

    @property
    def covariance(self) -> Array:
        """(p, p) of the parameters that act."""
        ...

    def reading(self, force: Array) -> Array: ...
    def force(self, reading: Array) -> Array: ...
    def slope(self, force: Array) -> Array:
        """(n, 3, p) of the corrected force by the parameters, at a reading of `force`."""
        ...


@dataclass(frozen=True)
class OneSensor:
    """A calibration with covariates where a later reading finds them."""

    calibration: Calibration
    part: Acting

    @property
    def covariance(self) -> Array:
        return self.calibration.covariance[np.ix_(self.part.at, self.part.at)]

    def _context(self, n: int) -> Context:
        before = {f"previous_{axis}": np.zeros(n) for axis in "xyz"}
        return Context(n, {**before, **self.calibration.usual(n)})

    def reading(self, force: Array) -> Array:
        part, context = self.part, self._context(len(force))
        return part.model.predict(part.theta, force[:, None], context).reading[:, 0]

    def force(self, reading: Array) -> Array:
        part, context = self.part, self._context(len(reading))
        return part.model.correct(part.theta, reading[:, None], context)[:, 0]

    def slope(self, force: Array) -> Array:
        part = self.part
        seen = part.model.predict(part.theta, force[:, None], self._context(len(force)))
        return np.asarray(-np.linalg.solve(seen.d_truth[:, 0], seen.d_theta[:, 0]))

    def reading_slope(self, force: Array) -> Array:
        """(n, 3, p) of the reading by the parameters."""
        part = self.part
        seen = part.model.predict(part.theta, force[:, None], self._context(len(force)))
        return seen.d_theta[:, 0]


def sensor_of(calibration: Calibration) -> OneSensor:
    """Raises UnreadableInput for effects that are not known."""
    return OneSensor(calibration, acting(calibration, fixture=False))


@dataclass(frozen=True)
class ArrayImu:
    """One IMU, in board axes: reading = gain · force + bias."""

    triad: Triad

    @property
    def covariance(self) -> Array:
        return self.triad.covariance

    def reading(self, force: Array) -> Array:
        return np.asarray(force @ self.triad.gain.T + self.triad.bias)

    def force(self, reading: Array) -> Array:
        return np.asarray(np.linalg.solve(self.triad.gain, (reading - self.triad.bias).T).T)

    def slope(self, force: Array) -> Array:
        n = len(force)
        by_gain = np.einsum("ij,nk->nijk", np.eye(3), force).reshape(n, 3, 9)
        both = np.concatenate([by_gain, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)
        return np.asarray(-np.linalg.solve(self.triad.gain, both))
