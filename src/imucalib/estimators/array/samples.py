"""The motion of each sample given positions, with every reading weighted by itself.

Nine unknowns a sample: s (specific force of the first triad), dω/dt and ω, by Gauss-Newton. What is
kept of it (`Sampled`) is all that a score test needs to take the motion out of any column. What the
accelerometers say of (s, W), a force being (s, W) times (1, r), are twelve numbers and a matrix,
whatever the number of IMUs; each step runs on these.

Columns of a model act on one triad at one kind of sensor, or are shared by all triads. So their
plain products are a small matrix a triad, and what the motion takes from them has nine rows a
sample: they are never stacked to the length of all readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.core.course import bends_of, slope_of
from imucalib.core.effect import cross_matrix
from imucalib.core.eigen import eigen

_ROUNDS = 12
#: rad/s, a last step: sums of scores over thousands of samples show what a coarser one leaves.
_LAST = 1e-6
#: (rad/s²)^-2, of dω/dt about zero: 3e6 deg/s², a hundred times what hands do. IMUs on one line say
#: nothing of the spin about it, and this alone keeps that one number finite.
SPIN = np.deg2rad(3e6) ** -2.0
_ROWS = 600  # samples that are worked on at a time, within the processor's cache


class Pair(NamedTuple):
    """Of accelerometers and of gyros, in board axes and SI units: readings (T, K, 3), or what they
    are weighted by, the inverse variances (T, K) of each triad's axes."""

    acceleration: Array
    rate: Array

    def take(self, rows: Index) -> Pair:
        return Pair(self.acceleration[rows], self.rate[rows])

    def less(self, other: Pair) -> Pair:
        return Pair(self.acceleration - other.acceleration, self.rate - other.rate)


@dataclass(frozen=True)
class Sampled:
    """Positions' best motion and what it leaves.

    rate, spin, origin : (T, 3) ω, dω/dt and s; force : (T, K, 3) predicted specific force
    turn : (T, 3, 3) W, the derivative of a force by its position
    off : residuals; weights : what they were weighted by
    r : (K, 3) m, the positions; root : (T, 9, 9), upper triangular, with root rootᵀ the covariance
        of the nine
    """

    rate: Array
    spin: Array
    origin: Array
    force: Array
    turn: Array
    off: Pair
    weights: Pair
    r: Array
    root: Array

    def take(self, rows: Index) -> Sampled:
        own = ("rate", "spin", "origin", "force", "turn", "root")
        each = {name: getattr(self, name)[rows] for name in own}
        return replace(self, off=self.off.take(rows), weights=self.weights.take(rows), **each)

    @cached_property
    def arms(self) -> Array:
        """(T, K, 3, 9) derivative of the forces by s, dω/dt, ω."""
        slope = slope_by_motion(self.rate).reshape(-1, 3, 4, 9)
        return np.asarray(np.einsum("ka,tiaj->tkij", places(self.r)[0], slope))

    def jerk(self, t: Array, beside: Flags) -> Array:
        """(T, K, 3) m/s³ of the forces by the motion of the neighbours, zero where a sample has
        none. How the board turns is known with its derivative, the force amid the IMUs is not: only
        there are differences all that there is.

        t : (T,) s; beside : (T, 2) whether the sample before and the one after are neighbours
        """
        bend, _ = bends_of(self.rate, self.spin, t, beside)
        amid = np.mean(self.r, axis=0)
        common = slope_of(self.origin + self.turn @ amid, t, beside)
        mixed = self.rate[:, :, None] * self.spin[:, None]
        trace = 2.0 * np.sum(self.rate * self.spin, axis=1)[:, None, None] * np.eye(3)
        turning = mixed + mixed.transpose(0, 2, 1) - trace + cross_matrix(bend)  # dW/dt
        turning *= np.any(beside, axis=1)[:, None, None]
        return np.asarray(common[:, None] + (self.r - amid) @ turning.transpose(0, 2, 1))

    @cached_property
    def kept(self) -> tuple[Kept, Kept]:
        """What the motion leaves of the errors of accelerometers and of gyros."""
        t, pairs = len(self.rate), places(self.r)[1]
        reach = np.matmul(slope_by_motion(self.rate), self.root)
        moved = np.matmul(reach, reach.transpose(0, 2, 1)).reshape(t, 3, 4, 3, 4)
        moved = moved.transpose(0, 1, 3, 2, 4).reshape(t, 9, 16) @ pairs.T
        turned = self.root[:, 6:] @ self.root[:, 6:].transpose(0, 2, 1)
        weights = self.weights
        return (
            _keep(moved.transpose(0, 2, 1) * weights.acceleration[..., None]),
            _keep(turned.reshape(t, 1, 9) * weights.rate[..., None]),
        )


@dataclass(frozen=True)
class Kept:
    """share : (T, K) of the variance of a triad's axis that its residual keeps; numbers : (T, K)
    how many independent numbers a residual has, (Σ λ)² / Σ λ² of the shares λ of its principal
    axes: three where alike, one where the motion takes all but one (Satterthwaite 1946)"""

    share: Array
    numbers: Array


def _keep(lost: Array) -> Kept:
    """lost : (T, K, 9) what the motion takes of a triad's covariance, over that of one axis"""
    own = np.eye(3).ravel() - lost
    whole = own[..., 0] + own[..., 4] + own[..., 8]
    square = np.einsum("tki,tki->tk", own, own)
    floor = 0.02
    return Kept(np.maximum(whole / 3.0, floor), np.clip(whole**2 / square, 1.0, 3.0))


def find_sides(t: Array, longest: float) -> Flags:
    """(n, 2) whether the sample before and the one after are neighbours, at times t (n,) s of which
    those that are no more than `longest` apart are next to each other."""
    near = np.diff(t) < longest
    return np.column_stack([np.append(False, near), np.append(near, False)])


def turning(rate: Array, spin: Array) -> Array:
    """(T, 3, 3) W = Ω(ω)² + Ω(dω/dt)."""
    square = rate[:, :, None] * rate[:, None]
    trace = np.sum(rate * rate, axis=1)[:, None, None] * np.eye(3)
    return np.asarray(square - trace + cross_matrix(spin))


def slope_by_motion(rate: Array) -> Array:
    """(T, 12, 9) derivative of (s, W), row by row, by s, dω/dt and ω."""
    out = np.zeros((len(rate), 3, 4, 9))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, i, 0, i] = 1.0
        out[:, i, 1 + j, 3 + k], out[:, j, 1 + i, 3 + k] = -1.0, 1.0
        out[:, i, 1 + i, 6 + j], out[:, i, 1 + i, 6 + k] = -2.0 * rate[:, j], -2.0 * rate[:, k]
        for a, b in ((i, j), (j, i)):
            out[:, a, 1 + b, 6 + i], out[:, a, 1 + b, 6 + j] = rate[:, j], rate[:, i]
    return out.reshape(-1, 12, 9)


def places(r: Array) -> tuple[Array, Array]:
    """(K, 4) and (K, 16): (1, r), and the products of the four."""
    place = np.concatenate([np.ones((len(r), 1)), r], axis=1)
    return place, (place[:, :, None] * place[:, None, :]).reshape(len(place), 16)


def lower_triangle(matrix: Array) -> Array:
    """(n, n, T) lower triangles L with L Lᵀ the positive matrices (n, n, T), of which only the
    lower half is read; NaN where one is not positive."""
    out = np.zeros_like(matrix)
    for j in range(len(matrix)):
        column = matrix[j:, j] - np.einsum("kt,ikt->it", out[j, :j], out[j:, :j])
        out[j:, j] = column / np.sqrt(column[0])
    return out


def inverse_roots(matrix: Array) -> Array:
    """(T, n, n) upper triangles with root rootᵀ the inverse of each positive matrix (T, n, n); NaN
    where one is not. The samples are last in memory: a library call for each would cost ten times
    what its few sums do."""
    last = matrix.transpose(1, 2, 0)
    # In like units: a spin that only its prior holds is a small number beside the others.
    size = 1.0 / np.sqrt(np.einsum("iit->it", last))
    lower = lower_triangle(last * size[:, None] * size)
    out = np.zeros_like(lower)
    for i in range(len(lower)):
        out[i, i] = 1.0 / lower[i, i]
        out[i, :i] = np.einsum("kt,kjt->jt", lower[i, :i], out[:i, :i]) * -out[i, i]
    return np.asarray((out * size).transpose(2, 1, 0))


@dataclass(frozen=True)
class Information:
    """What the readings of T samples say. normal, along : (T, 12, 12) and (T, 12) of (s, W), row by
    row; own, pull : (T, 6, 6) and (T, 6) of dω/dt and ω by themselves, weak priors included"""

    normal: Array
    along: Array
    own: Array
    pull: Array

    def roots(self, rate: Array, rows: Index | slice = slice(None)) -> Array:
        """(n, 9, 9) with root rootᵀ the covariance of the nine of some samples that turn by rate
        (n, 3)."""
        slope = slope_by_motion(rate)
        matrix = np.matmul(slope.transpose(0, 2, 1), np.matmul(self.normal[rows], slope))
        matrix[:, 3:, 3:] += self.own[rows]
        with np.errstate(invalid="ignore"):
            return inverse_roots(matrix)

    def fit(
        self, start: Array, rounds: int, close: float, longest: float = np.inf
    ) -> tuple[Array, Array]:
        """The nine (T, 9) of every sample and the roots of their covariances, by Gauss-Newton.

        close : rad/s, a last step; longest : rad/s, of one step
        """
        x, root = start.copy(), np.empty((len(start), 9, 9))
        rows: Index = np.arange(len(start))
        for _ in range(rounds):
            at = x[rows]
            root[rows] = own = self.roots(at[:, 6:], rows)
            state = np.concatenate([at[:, :3, None], turning(at[:, 6:], at[:, 3:6])], axis=2)
            off = self.along[rows] - np.matmul(self.normal[rows], state.reshape(-1, 12, 1))[..., 0]
            right = np.matmul(off[:, None], slope_by_motion(at[:, 6:]))
            right[:, 0, 3:] += self.pull[rows]
            right[:, 0, 3:] -= np.matmul(self.own[rows], at[:, 3:, None])[..., 0]
            step = np.matmul(own, np.matmul(right, own).swapaxes(1, 2))[..., 0]
            moved = np.linalg.norm(step[:, 6:], axis=1)
            x[rows] += np.minimum(1.0, longest / np.maximum(moved, 1e-300))[:, None] * step
            rows = rows[moved > close]
            if not len(rows):
                break
        return x, root


def _information(readings: Pair, weights: Pair, r: Array) -> Information:
    """Of triads whose three axes count alike."""
    t, (place, pairs) = len(readings.rate), places(r)
    normal = np.zeros((t, 3, 4, 3, 4))
    normal[:, range(3), :, range(3)] = (weights.acceleration @ pairs).reshape(t, 4, 4)
    heavy = (readings.acceleration * weights.acceleration[..., None]).transpose(0, 2, 1)
    own, pull = np.zeros((t, 6, 6)), np.zeros((t, 6))
    own[:, range(3), range(3)] = SPIN
    own[:, range(3, 6), range(3, 6)] = weights.rate.sum(axis=1)[:, None]
    pull[:, 3:] = np.einsum("tk,tki->ti", weights.rate, readings.rate)
    along = np.matmul(heavy, place)
    return Information(normal.reshape(t, 12, 12), along.reshape(t, 12), own, pull)


def fit_samples(
    readings: Pair, weights: Pair, r: Array, start: Array | Sampled, rounds: int = _ROUNDS
) -> Sampled:
    """Best motion of every sample; start : (T, 3) rad/s, or the motion of a fit nearby; rounds :
    steps at most, one where the weights are about to change.

    Raises numpy.linalg.LinAlgError where a sample runs away: no motion close to the start fits its
    readings.
    """
    if isinstance(start, Sampled):
        first = np.concatenate([start.origin, start.spin, start.rate], axis=1)
    else:
        first = np.concatenate([np.zeros((len(start), 6)), start], axis=1)
    x, root = _information(readings, weights, r).fit(first, rounds, _LAST)
    if not np.isfinite(x).all():
        raise np.linalg.LinAlgError("the motion of a sample runs away")
    rate, turn = x[:, 6:], turning(x[:, 6:], x[:, 3:6])
    force = x[:, None, :3] + r @ turn.transpose(0, 2, 1)
    return Sampled(
        rate=rate,
        spin=x[:, 3:6],
        origin=x[:, :3],
        force=force,
        turn=turn,
        off=Pair(readings.acceleration - force, readings.rate - rate[:, None]),
        weights=weights,
        r=r,
        root=root,
    )


def reweigh(sampled: Sampled, acceleration: float, rate: float) -> Sampled:
    """The same motion with all weights of each kind of sensor times a factor."""
    weights = Pair(sampled.weights.acceleration * acceleration, sampled.weights.rate * rate)
    rest = Pair(sampled.force, sampled.off.rate)  # whatever they read, they say as much
    root = _information(rest, weights, sampled.r).roots(sampled.rate)
    return replace(sampled, weights=weights, root=root)


@dataclass(frozen=True)
class Columns:
    """basis : (K, T, 3, m) per unit: each triad's columns lie side by side in memory; gyro : which
    kind of sensor it acts on; shared : one set of parameters for all triads, not one a triad"""

    basis: Array
    gyro: bool
    shared: bool

    @property
    def size(self) -> int:
        return int(self.basis.shape[3] * (1 if self.shared else self.basis.shape[0]))

    def of(self, triad: int) -> Index:
        """(m,) which of its parameters act on a triad."""
        width = self.basis.shape[3]
        return np.arange(width) + (0 if self.shared else triad * width)

    def at(self, theta: Array) -> Array:
        """(T, K, 3) what parameters (size,) add to the readings."""
        k, t, _, width = self.basis.shape
        table = np.broadcast_to(theta.reshape(-1, width, 1), (k, width, 1))
        made = np.matmul(self.basis.reshape(k, 3 * t, width), table)
        return np.asarray(made.reshape(k, t, 3).swapaxes(0, 1))


@dataclass(frozen=True)
class Gram:
    """matrix : (M, M); along : (M,) products with the residual; power : of the residual"""

    matrix: Array
    along: Array
    power: float


def gram(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Gram:
    """Products of all columns (M,), those of the blocks one after the other, over some samples."""
    total = sum(block.size for block in blocks)
    matrix, along, power = np.zeros((total, total)), np.zeros(total), 0.0
    for a in range(0, len(rows), _ROWS):
        power += _add(sampled, blocks, rows[a : a + _ROWS], matrix, along)
    return Gram(matrix, along, power)


def _add(
    sampled: Sampled, blocks: Sequence[Columns], rows: Index, matrix: Array, along: Array
) -> float:
    """Add the products over a few samples to matrix and along; the residual's own.

    What the motion takes of accelerometers is along s and dω/dt (six) and along ω (three). Gyros
    see ω only, and the root of the motion's covariance is upper triangular.
    """
    n, root, k = len(rows), sampled.root[rows], sampled.force.shape[1]
    starts = np.cumsum([0, *(block.size for block in blocks)])
    force = np.flatnonzero(np.repeat([not b.gyro for b in blocks], [b.size for b in blocks]))
    six, three = np.zeros((n, 6, len(force))), np.zeros((n, 3, len(along)))
    residual, power = np.zeros((n, 9)), 0.0
    for gyro in (False, True):
        mine = [(b, start) for b, start in zip(blocks, starts, strict=False) if b.gyro is gyro]
        weight = np.sqrt(sampled.weights[gyro][rows])
        off = sampled.off[gyro][rows] * weight[..., None]
        power += float(np.sum(off * off))
        for triad in range(k):
            arms = root[:, 6:] if gyro else np.matmul(sampled.arms[rows, triad], root)
            arms = (arms * weight[:, triad, None, None]).transpose(0, 2, 1)
            residual += np.matmul(arms, off[:, triad, :, None])[..., 0]
            if not mine:
                continue
            x = np.concatenate([b.basis[triad, rows] for b, _ in mine], axis=2)
            x *= weight[:, triad, None, None]
            columns = np.concatenate([start + b.of(triad) for b, start in mine])
            flat = x.reshape(3 * n, len(columns))
            matrix[np.ix_(columns, columns)] += flat.T @ flat
            along[columns] += flat.T @ off[:, triad].ravel()
            if not gyro:
                six[:, :, np.searchsorted(force, columns)] += np.matmul(arms[:, :6], x)
            three[:, :, columns] += np.matmul(arms[:, 6:], x)
    flat_six, flat_three = six.reshape(6 * n, -1), three.reshape(3 * n, -1)
    matrix[np.ix_(force, force)] -= flat_six.T @ flat_six
    matrix -= flat_three.T @ flat_three
    along[force] -= flat_six.T @ residual[:, :6].ravel()
    along -= flat_three.T @ residual[:, 6:].ravel()
    return power - float(np.sum(residual * residual))


def gradient(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Array:
    """(M,) products of the columns with the residual alone; at the samples' best motion, which
    leaves nothing along it, the same as `Gram.along`."""
    of = [np.zeros((sampled.force.shape[1], len(sampled.rate), 3)) for _ in range(2)]
    for gyro, heavy in enumerate(of):
        heavy[:, rows] = _heavy(sampled, rows, gyro=bool(gyro))
    parts = []
    for block in blocks:
        k, t, _, width = block.basis.shape
        flat = of[block.gyro].reshape(k, 1, 3 * t)
        each = np.matmul(flat, block.basis.reshape(k, 3 * t, width))[:, 0]
        parts.append(each.sum(axis=0) if block.shared else each.ravel())
    return np.concatenate(parts)


def scores(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Array:
    """(rows, M) the same of each sample by itself."""
    parts = []
    for block in blocks:
        heavy = _heavy(sampled, rows, gyro=block.gyro)
        each = np.einsum("ktim,kti->tkm", block.basis[:, rows], heavy)
        parts.append(each.sum(axis=1) if block.shared else each.reshape(len(rows), -1))
    return np.concatenate(parts, axis=1)


def _heavy(sampled: Sampled, rows: Index, *, gyro: bool) -> Array:
    """(K, rows, 3) weighted residuals of one kind of sensor."""
    weight = sampled.weights[gyro][rows][..., None]
    return np.asarray((sampled.off[gyro][rows] * weight).swapaxes(0, 1))


def project_out_motion(sampled: Sampled, change: Pair) -> Pair:
    """What remains of a change (T, K, 3) of the readings when the motion follows it, to first
    order."""
    n, k = change.rate.shape[:2]
    arms = sampled.arms.reshape(n, 3 * k, 9)
    heavy = change.acceleration * sampled.weights.acceleration[..., None]
    right = np.matmul(heavy.reshape(n, 1, 3 * k), arms)
    right[:, 0, 6:] += np.einsum("tk,tki->ti", sampled.weights.rate, change.rate)
    nine = np.matmul(sampled.root, np.matmul(right, sampled.root).transpose(0, 2, 1))
    moved = np.matmul(arms, nine).reshape(n, k, 3)
    return Pair(change.acceleration - moved, change.rate - nine[:, None, 6:, 0])


def marginalize(matrix: Array, prior: Array) -> Array:
    """(m, m) products (b + m, b + m) of columns with the first b taken out of the others, in the
    place of the matrix: of many IMUs another would be large.

    prior : (b,) inverse variances of the first columns' parameters, zero for free ones
    """
    b = len(prior)
    across = inverse_root(matrix[:b, :b] + np.diag(prior)).T @ matrix[:b, b:]
    matrix[b:, b:] -= across.T @ across
    return matrix[b:, b:]


def inverse_root(inner: Array) -> Array:
    """(b, q) with root rootᵀ the inverse of a matrix, its open directions left out."""
    from scipy.linalg.lapack import dtrtri

    size = 1.0 / np.sqrt(np.maximum(np.diag(inner), 1e-300))[:, None]
    unit = inner * size * size.T
    try:
        lower = np.linalg.cholesky(unit)
        if float(np.diag(lower).min(initial=1.0)) > 1e-4:
            return np.asarray(size * dtrtri(lower, lower=1)[0].T)
    except np.linalg.LinAlgError:
        pass
    values, vectors = eigen(unit)
    use = values > 1e-11 * max(float(values[-1]), 1e-300)
    return np.asarray(size * vectors[:, use] / np.sqrt(values[use]))
