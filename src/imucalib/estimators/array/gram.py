"""Gram matrices of an array's columns with the motion of every sample taken out.

A column acts on one triad at one kind of sensor, or is shared by all triads. So the plain products
are a small matrix a triad, and what the motion takes from them has nine rows a sample: the
columns are never stacked to the length of all readings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.array.reduced import Gram
from imucalib.estimators.array.samples import Readings, Sampled

_ROWS, _COLUMNS = 600, 1024  # samples, and columns, that are worked on at a time


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

    def at(self, theta: Array) -> Array:
        """(T, K, 3) what parameters (size,) add to the readings."""
        k, t, _, width = self.basis.shape
        table = np.broadcast_to(theta.reshape(-1, width, 1), (k, width, 1))
        made = np.matmul(self.basis.reshape(k, 3 * t, width), table)
        return np.asarray(made.reshape(k, t, 3).swapaxes(0, 1))


def starts_of(blocks: Sequence[Columns]) -> Index:
    """(blocks + 1,) first column of each block, and the end."""
    return np.cumsum([0] + [b.size for b in blocks]).astype(np.intp)


def gram(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Gram:
    """Products of all columns over some of the samples, a few at a time, so that what is made of
    them stays near the processor."""
    found = _part(sampled, blocks, rows[:_ROWS])
    for a in range(_ROWS, len(rows), _ROWS):
        found = found.added(_part(sampled, blocks, rows[a : a + _ROWS]))
    return found


def _part(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Gram:
    apart = taken_apart(sampled, blocks, rows)
    total, force = len(apart.place), apart.six.shape[1]
    # In the order of the blocks from here on: one matrix of all columns, and no copy.
    across = np.take(apart.three, np.argsort(apart.place), axis=1)
    matrix, whole = across.T @ across, np.zeros(total)
    np.negative(matrix, out=matrix)
    for a in range(0, force, _COLUMNS):
        some = slice(a, a + _COLUMNS)
        matrix[np.ix_(apart.place[:force][some], apart.place[:force])] -= (
            apart.six[:, some].T @ apart.six
        )
    for columns, product in apart.products:
        matrix[np.ix_(columns, columns)] += product
        whole[columns] += np.diag(product)
    return Gram(matrix, apart.along, apart.power, apart.numbers, whole)


@dataclass(frozen=True)
class Apart:
    """The products of M columns before they are put together, over n samples.

    place : (M,) of columns in the order of `_by_triad`, their place in that of the blocks
    six, three : (6 n, force) and (3 n, M) what the motion takes of them along s and dω/dt, and
        along ω, in the order of `_by_triad`: gyros see ω only, and the root is upper triangular
    products : (c, c) of a triad's c columns before, and their places (c,); along : (M,) in the
    order of the blocks, power, numbers : as in `Gram`
    """

    place: Index
    six: Array
    three: Array
    products: list[tuple[Index, Array]]
    along: Array
    power: float
    numbers: int


def taken_apart(sampled: Sampled, blocks: Sequence[Columns], rows: Index) -> Apart:
    """All that the products of the columns are made of."""
    k = sampled.force.shape[1]
    place, force = _by_triad(blocks, k)
    total, n = len(place), len(rows)
    along, residual = np.zeros(total), np.zeros((n, 9))
    six, three = np.zeros((n, 6, force)), np.zeros((n, 3, total))
    products, power = [], 0.0
    for gyro, at in ((False, slice(0, force)), (True, slice(force, total))):
        taken = _Taken(None if gyro else six, three[:, :, at], residual)
        kind = _of_one_kind(sampled, blocks, rows, taken, gyro=gyro)
        along[at], power = kind.along, power + kind.power
        products += [(place[at][columns], product) for columns, product in kind.products]
    flat, across = six.reshape(6 * n, force), three.reshape(3 * n, total)
    along[:force] -= flat.T @ residual[:, :6].ravel()
    along -= across.T @ residual[:, 6:].ravel()
    power -= float(np.sum(residual * residual))
    back = along[np.argsort(place)]
    return Apart(
        place=place,
        six=flat,
        three=across,
        products=products,
        along=back,
        power=power,
        numbers=(6 * k - 9) * n,
    )


@dataclass(frozen=True)
class _Kind:
    """Of the m columns of one kind of sensor: products (c, c) of a triad's c columns, with which of
    the m these are; along (m,), power"""

    products: list[tuple[Index, Array]]
    along: Array
    power: float


@dataclass(frozen=True)
class _Taken:
    """What the motion takes, filled in place: of columns, along s and dω/dt (rows, 6, m) and along
    ω (rows, 3, m); of the residual (rows, 9), to which both kinds add."""

    six: Array | None
    three: Array
    residual: Array


def _of_one_kind(
    sampled: Sampled, blocks: Sequence[Columns], rows: Index, taken: _Taken, *, gyro: bool
) -> _Kind:
    k, root = sampled.force.shape[1], sampled.root[rows]
    weight = np.sqrt((sampled.weights.rate if gyro else sampled.weights.acceleration)[rows])
    off = (sampled.off.rate if gyro else sampled.off.acceleration)[rows] * weight[..., None]
    own = [b.basis for b in blocks if b.gyro is gyro and not b.shared]
    shared = [b.basis for b in blocks if b.gyro is gyro and b.shared]
    width = sum(b.shape[3] for b in own)
    x = np.empty((len(rows), 3, width + sum(b.shape[3] for b in shared)))
    size = k * width + x.shape[2] - width
    products, along, common = [], np.zeros(size), slice(k * width, size)
    for triad in range(k):
        mine = slice(triad * width, (triad + 1) * width)
        side_by_side([*own, *shared], triad, rows, weight[:, triad], x)
        one = x.reshape(3 * len(rows), x.shape[2])
        columns = np.concatenate([np.arange(size)[mine], np.arange(size)[common]])
        products.append((columns, one.T @ one))
        seen = one.T @ off[:, triad].ravel()
        along[mine], along[common] = seen[:width], along[common] + seen[width:]
        arms = root[:, 6:] if gyro else np.matmul(sampled.arms[rows, triad], root)
        arms = arms * weight[:, triad, None, None]
        lost = np.matmul((arms[:, :, 6:] if gyro else arms).transpose(0, 2, 1), x)
        for out, part in ((taken.six, lost[:, :-3]), (taken.three, lost[:, -3:])):
            if out is not None:
                out[:, :, mine] = part[:, :, :width]
                out[:, :, common] += part[:, :, width:]
        taken.residual[...] += np.einsum("tij,ti->tj", arms, off[:, triad])
    return _Kind(products, along, float(np.sum(off * off)))


def _by_triad(blocks: Sequence[Columns], triads: int) -> tuple[Index, int]:
    """(M,) all columns in the order in which each triad's own stand side by side, those of the
    accelerometers first and shared ones after all triads; and how many are the accelerometers'."""
    starts, order, force = starts_of(blocks), [], 0
    for gyro in (False, True):
        chosen = [b for b in range(len(blocks)) if blocks[b].gyro is gyro]
        own = [b for b in chosen if not blocks[b].shared]
        for triad in range(triads):
            for b in own:
                width = blocks[b].basis.shape[3]
                order.append(starts[b] + triad * width + np.arange(width))
        order += [np.arange(starts[b], starts[b + 1]) for b in chosen if blocks[b].shared]
        if not gyro:
            force = sum(len(part) for part in order)
    return np.concatenate(order).astype(np.intp), force


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


def beside_motion(sampled: Sampled, change: Readings, rows: Index | slice) -> Readings:
    """What is left of a change (n, K, 3) of the readings at some samples when their motion follows
    it, to first order."""
    n, k = change.rate.shape[:2]
    arms, root = sampled.arms[rows].reshape(n, 3 * k, 9), sampled.root[rows]
    heavy = change.acceleration * sampled.weights.acceleration[rows][..., None]
    right = np.matmul(heavy.reshape(n, 1, 3 * k), arms)
    right[:, 0, 6:] += np.einsum("tk,tki->ti", sampled.weights.rate[rows], change.rate)
    nine = np.matmul(root, np.matmul(right, root).transpose(0, 2, 1))
    moved = np.matmul(arms, nine).reshape(n, k, 3)
    return Readings(change.acceleration - moved, change.rate - nine[:, None, 6:, 0])


def _heavy(sampled: Sampled, rows: Index, *, gyro: bool) -> Array:
    """(K, rows, 3) weighted residuals of one kind of sensor."""
    weight = sampled.weights.rate if gyro else sampled.weights.acceleration
    off = sampled.off.rate if gyro else sampled.off.acceleration
    return np.asarray((off[rows] * weight[rows][..., None]).swapaxes(0, 1))


def side_by_side(bases: list[Array], triad: int, rows: Index, weight: Array, out: Array) -> None:
    """Fill (rows, 3, all columns of a triad), whitened by weights (rows,)."""
    at = 0
    for basis in bases:
        width = basis.shape[3]
        out[..., at : at + width] = basis[triad, rows]
        at += width
    out *= weight[:, None, None]
