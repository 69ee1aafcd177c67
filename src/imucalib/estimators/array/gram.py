"""Products of an array's columns with the motion of every sample taken out.

A column acts on one triad at one kind of sensor, or is shared by all triads. So the plain products
are a small matrix a triad, and what the motion takes from them has nine rows a sample: the
columns are never stacked to the length of all readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.estimators.array.samples import Pair, Sampled

_ROWS = 600  # samples that are worked on at a time, within the processor's cache


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
