"""What an array's model holds beside the positions: errors of the rests, and accepted effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array.static import StaticFit
from imucalib.core.array_motion import ArrayEffect, ArrayMotion
from imucalib.core.parameter import Parameter
from imucalib.estimators.array.gram import Columns

Array = NDArray[np.float64]
SMALLEST, LARGEST = 1e-3, 10.0  # believable sizes of an effect, in its typical ones
OPEN = 0.05  # λ at typical size below which a direction says nothing


@dataclass(frozen=True)
class Term:
    """An effect with its estimate.

    name : of the effect, with "@imu3" when it acts on one IMU only; only : that IMU or None
    live : (p, q) its parameters per unit of the q coordinates that the data can determine; the
        others are held at zero
    value, sd : (q,) the coordinates and their prior standard deviations
    found : whether the loop accepted it; otherwise it stands for what the rests left open
    """

    name: str
    effect: ArrayEffect
    only: int | None
    live: Array
    value: Array
    sd: Array
    found: bool = True

    @property
    def theta(self) -> Array:
        """(p,) in the parameters' units."""
        return np.asarray(self.live @ self.value)

    def parameters(self, imus: Sequence[str]) -> tuple[Parameter, ...]:
        chosen = imus if self.only is None else [imus[self.only]]
        return self.effect.parameters(chosen)

    def columns(self, motion: ArrayMotion) -> Columns:
        return columns_of(self.effect, motion, self.only)

    def reading(self, columns: Columns) -> Array:
        """(T, K, 3) what it adds to the readings of its sensors."""
        if columns.shared:
            return np.asarray(columns.basis @ self.theta)
        table = self.theta.reshape(columns.basis.shape[1], columns.basis.shape[3], 1)
        return np.asarray(np.matmul(columns.basis, table)[..., 0])

    def moved(self, step: Array, covariance: Array) -> Term:
        """After a step of its coordinates; the size of a found effect is learned along."""
        value = self.value + step
        sd = self.sd
        if self.found:
            size = np.sqrt(np.mean(value**2 + np.diag(covariance)))
            sd = np.full_like(self.sd, np.clip(size, SMALLEST, LARGEST))
        return replace(self, value=value, sd=sd)


def determined(name: str, effect: ArrayEffect, only: int | None, matrix: Array) -> Term:
    """A new term at zero, with the directions that the data can determine.

    matrix : (p, p) Gram of its columns in typical sizes, with all else that is fitted taken out
    """
    values, vectors = np.linalg.eigh(matrix)
    use = values > max(OPEN**2, 1e-9 * float(values[-1]))
    live = typical_of(effect, len(matrix))[:, None] * vectors[:, use]
    rank = int(use.sum())
    return Term(name, effect, only, live, np.zeros(rank), np.ones(rank))


def typical_of(effect: ArrayEffect, count: int) -> Array:
    """(count,) typical sizes of its columns."""
    each = np.array([p.typical for p in effect.each])
    return np.tile(each, count // len(each))


def columns_of(effect: ArrayEffect, motion: ArrayMotion, only: int | None = None) -> Columns:
    """Columns of an effect, per unit of its parameters."""
    basis = effect.basis(motion)
    gyro = effect.sensor == "gyroscope"
    if only is None:
        return Columns(np.ascontiguousarray(basis), gyro, effect.shared)
    alone = np.zeros_like(basis)
    alone[:, only] = basis[:, only]
    return Columns(alone, gyro, shared=True)


def _gain_and_offset(motion: ArrayMotion) -> Array:
    out = np.zeros((*motion.shape, 3, 12))
    for i in range(3):
        out[:, :, i, 3 * i : 3 * i + 3] = motion.force
        out[:, :, i, 9 + i] = 1.0
    return out


def _offset(motion: ArrayMotion) -> Array:
    return np.broadcast_to(np.eye(3), (*motion.shape, 3, 3))


def _rest(name: str, gyro: bool, each: int) -> ArrayEffect:
    parameters = tuple(Parameter(f"{name}_{k}", "SI", 1.0, np.inf) for k in range(each))
    return ArrayEffect(
        name, "gyroscope" if gyro else "accelerometer", "What the rests left open.", "", "", "",
        parameters, _offset if gyro else _gain_and_offset,
    )  # fmt: skip


def rest_terms(static: StaticFit) -> tuple[Term, ...]:
    """Errors of gains and offsets with the covariance that the rests left."""
    size = static.covariance.shape[0] * 12
    values, vectors = np.linalg.eigh(static.covariance.reshape(size, size))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    terms = []
    for effect, live in (
        (_rest("rests", False, 12), root),
        (_rest("rests_gyro", True, 3), np.diag(static.gyro_bias_sd.ravel())),
    ):
        n = live.shape[1]
        terms.append(Term(effect.name, effect, None, live, np.zeros(n), np.ones(n), found=False))
    return tuple(terms)
