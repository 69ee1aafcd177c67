"""What all gyros of an array share, told by its accelerometers: their frame and their delay.

The mean rate g stands for ω in the likelihood with precision P. Moving g by X p changes the log
likelihood at rate Σ XᵀP(ω* - g), ω* the conditional modes; the information is Σ XᵀFX with
F = P - P M P, M the conditional covariance. Common scale is left out: it trades off against the
array's size.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array_gyros import relative_gyros
from imucalib.calibrators.array_moving import Moving
from imucalib.estimators.array_likelihood import conditionals
from imucalib.estimators.array_mode import Frame
from imucalib.estimators.array_rotation import inverse, modes

Array = NDArray[np.float64]
Index = NDArray[np.intp]
#: Traceless 3 x 3 matrices: all common gain errors but the scale.
FRAME, DELAY = slice(0, 8), slice(8, 9)
_GAINS = np.array(
    [np.outer(np.eye(3)[i], np.eye(3)[j]) for i in range(3) for j in range(3) if i != j]
    + [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])]
)


@dataclass(frozen=True)
class CommonGyro:
    """gain : (3, 3) of the mean less the identity; delay : s, of the gyros behind the
    accelerometers; delay_sd : s"""

    gain: Array
    delay: float
    delay_sd: float


@dataclass(frozen=True)
class GyroScore:
    """Per sample, for the eight gains and the delay: right (T, 9), normal (T, 9, 9)."""

    right: Array
    normal: Array

    def solved(self, rows: Index, part: slice) -> tuple[Array, Array]:
        """The parameters `part` alone from some of the samples, and their covariance."""
        covariance = np.linalg.inv(self.normal[rows].sum(axis=0)[part, part])
        return covariance @ self.right[rows].sum(axis=0)[part], np.asarray(covariance)

    def gain(self, rows: Index, part: slice, value: Array) -> float:
        """By how much the log likelihood of other samples rises with these values (nats)."""
        normal = self.normal[rows].sum(axis=0)[part, part]
        return float(self.right[rows].sum(axis=0)[part] @ value - 0.5 * value @ normal @ value)


def gyro_score(frame: Frame, slope: Array) -> GyroScore:
    """At the mode; slope : (T, 3) rad/s² of the mean rate."""
    data, prior = frame.posterior.data, frame.posterior.prior
    given, _ = conditionals(data, prior, frame.mode[None])
    w, here = modes(given, frame.posterior.start)
    m = inverse(here.hessian)[0][0].transpose(2, 0, 1)
    p = np.broadcast_to(data.rate_precision, m.shape)
    information = p - p @ m @ p
    score = np.einsum("tij,tj->ti", p, w[0].T - data.rate)
    columns = np.concatenate(
        [np.einsum("cij,tj->tic", _GAINS, data.rate), slope[:, :, None]], axis=2
    )
    turned = np.einsum("tij,tjd->tid", information, columns)
    return GyroScore(
        np.einsum("tic,ti->tc", columns, score), np.einsum("tic,tid->tcd", columns, turned)
    )


def common_gyro(score: GyroScore, part: slice) -> CommonGyro:
    """From all samples, the parameters `part` only; the others stay zero."""
    value, covariance = score.solved(np.arange(len(score.right)), part)
    full, sd = np.zeros(9), np.zeros(9)
    full[part], sd[part] = value, np.sqrt(np.diag(covariance))
    gain = np.asarray(np.einsum("c,cij->ij", full[:8], _GAINS))
    return CommonGyro(gain, float(full[8]), float(sd[8]))


def with_common_gyro(moving: Moving, slope: Array, found: CommonGyro, rows: Index) -> Moving:
    """The moving part with frame and delay undone in every gyro."""
    shift = moving.gyros.mean @ found.gain.T + found.delay * np.nan_to_num(slope)
    rate = moving.rate + np.einsum("kij,nj->nki", moving.gyros.gain, shift)
    return replace(moving, rate=rate, gyros=relative_gyros(rate, rows))
