"""Accelerometer triads of an array from its rests: gravity of known size, unknown directions.

reading = M_k g u_p + b_k, maximum likelihood over all triads at once (paper 001, section IV-B, and
its reference 18). The directions u_p are shared, so the triads' orientation relative to each other
is determined; that of the whole set is not, and its mean over the triads is the board's frame.
A bias that drifts while the board warms up is a polynomial in time of the order that the Bayesian
information criterion chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array.board import Board
from imucalib.errors import Undetermined
from imucalib.rests.segments import Segments

Array = NDArray[np.float64]
FEWEST_POSES = 9
_VAGUE = 0.02  # standard deviation of a gain entry above which the attitudes are too alike
_LOOSE = 0.2  # largest believable deviation of a triad's gain from a plain one


@dataclass(frozen=True)
class StaticFit:
    """Triads in board axes.

    gain : (K, 3, 3) M; gain_sd : the same; bias : (order + 1, K, 3) m/s², coefficients of powers of
        (t - origin) / span, t kept within the rests; gyro_bias : the same, rad/s
    residual : m/s², rms per degree of freedom; before : without drift
    noise : (K,) m/s² of one sample; gyro_noise : (K,) rad/s
    covariance : (K, 12, K, 12) of every triad's gain (9, rows first) and offset at the end of the
        rests (3, m/s²): errors of the gravity directions are shared by all triads
    gyro_bias_sd : (K, 3) rad/s, of the offsets at the end of the rests
    poses : number; gravity : m/s²; order : of the drift; rotations : (K, 3, 3), package axes to
        board axes
    """

    gain: Array
    gain_sd: Array
    bias: Array
    gyro_bias: Array
    origin: float
    span: float
    residual: float
    before: float
    noise: Array
    gyro_noise: Array
    poses: int
    gravity: float
    covariance: Array
    gyro_bias_sd: Array
    rotations: Array

    @property
    def order(self) -> int:
        return len(self.bias) - 1

    def powers(self, t: Array) -> Array:
        """(N, order + 1) of the drift's time."""
        at = np.clip((t - self.origin) / self.span, -1.0, 0.0)
        return np.asarray(at[:, None] ** np.arange(self.order + 1))

    def corrected(self, acceleration: Array, t: Array) -> Array:
        """Specific force (N, K, 3) m/s² in the board's frame."""
        offset = np.einsum("no,oki->nki", self.powers(t), self.bias)
        return np.asarray(
            np.einsum("kij,nkj->nki", np.linalg.inv(self.gain), acceleration - offset)
        )

    def without_bias(self, rate: Array, t: Array) -> Array:
        """Angular rates (N, K, 3) rad/s less their offsets at rest."""
        return np.asarray(rate - np.einsum("no,oki->nki", self.powers(t), self.gyro_bias))


def fit_static(segments: Segments, board: Board, order: list[int], gravity: float) -> StaticFit:
    """Fit all triads; `order` gives the board's IMUs in the segments' triads.

    Raises Undetermined when there are too few or too similar rests.
    """
    if segments.n < FEWEST_POSES:
        raise Undetermined(
            f"{segments.n} rests found, at least {FEWEST_POSES} are needed to calibrate the "
            "accelerometers",
            remedy="hold the board still in nine or more attitudes, two seconds each; "
            "`imucal inspect` shows what counts as still",
        )
    y = np.einsum("kij,nkj->nki", board.rotations, segments.mean[:, order])
    _refuse_other_unit(y, board, gravity)
    middle = 0.5 * (segments.start + segments.stop)
    origin, span = float(middle[-1]), float(max(np.ptp(middle), 1e-9))
    late = (middle - origin) / span
    fits = [_fit(y, late, p, gravity) for p in range(3) if _enough(y, p)]
    chosen = min(fits, key=lambda f: f.criterion)
    if float(chosen.gain_sd.max()) > _VAGUE:
        raise Undetermined(
            "the attitudes of the rests are too alike to tell scale, misalignment and bias apart",
            remedy="turn the board so that each axis points up, down and sideways at least once",
        )
    worst = np.abs(chosen.gain - np.eye(3)).max(axis=(1, 2))
    if float(worst.max()) > _LOOSE:
        raise Undetermined(
            f"{board.imus[int(np.argmax(worst))]} differs from the board's drawing by "
            f"{100 * worst.max():.0f} % of gravity",
            remedy="check its mounting axes in the board file, and the unit of the recording",
        )
    rates = np.einsum("kij,nkj->nki", board.rotations, segments.rate[:, order])
    powers = late[:, None] ** np.arange(chosen.order + 1)
    drift = np.linalg.lstsq(powers, rates.reshape(len(rates), -1), rcond=None)[0]
    rate_sd = _offset_sd(powers, rates.reshape(len(rates), -1) - powers @ drift)
    noise = np.sqrt(np.mean(segments.noise[order] ** 2, axis=1))
    gyro_noise = np.sqrt(np.mean(segments.rate_noise[order] ** 2, axis=1))
    return StaticFit(
        chosen.gain, chosen.gain_sd, chosen.bias, drift.reshape(-1, board.count, 3), origin, span,
        chosen.rms, fits[0].rms, noise, gyro_noise, segments.n, gravity, chosen.covariance,
        rate_sd.reshape(board.count, 3), board.rotations,
    )  # fmt: skip


def _refuse_other_unit(y: Array, board: Board, gravity: float) -> None:
    """y : (n, K, 3) readings at rest, whose size offsets do not double or halve."""
    ratio = np.median(np.linalg.norm(y, axis=2), axis=0) / gravity
    worst = int(np.argmax(np.abs(np.log(np.maximum(ratio, 1e-9)))))
    if not 0.5 < ratio[worst] < 2.0:
        raise Undetermined(
            f"{board.imus[worst]} reads {ratio[worst]:.2g} times gravity at rest",
            remedy="its unit is not what the recording or its mapping says (g against m/s²: 9.81)",
        )


def _offset_sd(powers: Array, residual: Array) -> Array:
    """Standard deviation (m,) of the offsets at the end of the rests, from their residuals."""
    freedom = max(len(residual) - powers.shape[1], 1)
    leverage = float(np.linalg.inv(powers.T @ powers)[0, 0])
    return np.asarray(np.sqrt(leverage * np.sum(residual**2, axis=0) / freedom))


@dataclass(frozen=True)
class _Attempt:
    gain: Array
    gain_sd: Array
    covariance: Array
    bias: Array
    rms: float
    criterion: float
    order: int


def _unknowns(poses: int, triads: int, order: int) -> int:
    return 9 * triads + 3 * triads * (order + 1) + 2 * poses - 3


def _enough(y: Array, order: int) -> bool:
    poses, triads, _ = y.shape
    return order == 0 or _unknowns(poses, triads, order) < 0.6 * y.size


def _fit(y: Array, late: Array, order: int, gravity: float) -> _Attempt:
    """Gauss-Newton from plain triads; converges in a few steps since they are nearly that."""
    poses, triads, _ = y.shape
    u = y.mean(axis=1)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    gain = np.broadcast_to(np.eye(3), (triads, 3, 3)).copy()
    bias = np.zeros((order + 1, triads, 3))
    powers = late[:, None] ** np.arange(order + 1)
    covariance = np.empty((0, 0))
    for _ in range(12):
        residual = y - gravity * np.einsum("kij,nj->nki", gain, u)
        residual -= np.einsum("no,oki->nki", powers, bias)
        tangent = _tangents(u)
        columns = _columns(u, tangent, gain, powers, gravity)
        step, covariance = _solve(columns, residual.ravel(), triads)
        split = 9 * triads, 9 * triads + bias.size
        gain += step[: split[0]].reshape(triads, 3, 3)
        bias += step[split[0] : split[1]].reshape(bias.shape)
        u = u + np.einsum("nij,nj->ni", tangent, step[split[1] :].reshape(poses, 2))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        if np.abs(step).max() < 1e-10:
            break
    dof = max(y.size - _unknowns(poses, triads, order), 1)
    variance = float(np.sum(residual**2)) / dof
    sd = np.sqrt(np.maximum(np.diag(covariance)[: 9 * triads] * variance, 0.0))
    own = [
        np.concatenate([np.arange(9 * k, 9 * k + 9), 9 * triads + 3 * k + np.arange(3)])
        for k in range(triads)
    ]
    at = np.concatenate(own)
    joint = (covariance[np.ix_(at, at)] * variance).reshape(triads, 12, triads, 12)
    criterion = y.size * np.log(float(np.mean(residual**2))) + np.log(y.size) * _unknowns(
        poses, triads, order
    )
    return _Attempt(
        gain, sd.reshape(triads, 3, 3), joint, bias, float(np.sqrt(variance)), criterion, order
    )


def _tangents(u: Array) -> Array:
    """(n, 3, 2) two directions across each unit vector."""
    axis = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = np.cross(u, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=-1)


def _columns(u: Array, tangent: Array, gain: Array, powers: Array, gravity: float) -> Array:
    """(n K 3, unknowns) derivative of the readings by gains, biases and directions."""
    n, triads, order = len(u), len(gain), powers.shape[1]
    by_gain = np.zeros((n, triads, 3, triads, 3, 3))
    by_bias = np.zeros((n, triads, 3, order, triads, 3))
    by_way = np.zeros((n, triads, 3, n, 2))
    for k in range(triads):
        for i in range(3):
            by_gain[:, k, i, k, i] = gravity * u
            by_bias[:, k, i, :, k, i] = powers
    moved = gravity * np.einsum("kij,njc->nkic", gain, tangent)
    by_way[np.arange(n), :, :, np.arange(n)] = moved
    rows = n * triads * 3
    return np.concatenate([part.reshape(rows, -1) for part in (by_gain, by_bias, by_way)], axis=1)


def _solve(columns: Array, residual: Array, triads: int) -> tuple[Array, Array]:
    """Least squares step with the mean rotation of the gains held, and its unit covariance."""
    held = np.zeros((3, columns.shape[1]))
    for row, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        block = np.zeros((triads, 3, 3))
        block[:, i, j], block[:, j, i] = 1.0, -1.0
        held[row, : 9 * triads] = block.ravel()
    normal = columns.T @ columns + 1e2 * held.T @ held
    normal[np.diag_indices_from(normal)] += 1e-10
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    return covariance @ (columns.T @ residual), covariance
