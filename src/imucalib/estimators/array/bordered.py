"""Candidates beside a base: what each by itself needs, without the products of one with another.

Hundreds of candidates are scored and one is taken. Their evidence asks for the products with the
base and for those within each; only chance, the best of all on data that lack nothing, asks how
they go together, and there simulated noise passes through the columns themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.array.gram import Columns, side_by_side, starts_of, taken_apart
from imucalib.estimators.array.reduced import Gram, inverse_root
from imucalib.estimators.array.samples import Sampled

_ROWS = 600  # samples that are worked on at a time


@dataclass(frozen=True)
class Bordered:
    """base : (b, b); across : (b, m) products with the candidates' columns; own : of each block of
    columns its own (w, w); along, whole : (m,) as in `Gram`"""

    base: Gram
    across: Array
    own: tuple[Array, ...]
    along: Array
    whole: Array

    def added(self, other: Bordered) -> Bordered:
        """The sum, in the place of this one's matrices."""
        for one, two in ((self.across, other.across), *zip(self.own, other.own, strict=True)):
            np.add(one, two, out=one)
        return replace(
            self, base=self.base.added(other.base), along=self.along + other.along,
            whole=self.whole + other.whole,
        )  # fmt: skip


def bordered(
    sampled: Sampled, base: Sequence[Columns], beside: Sequence[Columns], rows: Index
) -> Bordered:
    """Products over some of the samples, a few at a time."""
    found = _part(sampled, base, beside, rows[:_ROWS])
    for a in range(_ROWS, len(rows), _ROWS):
        found = found.added(_part(sampled, base, beside, rows[a : a + _ROWS]))
    return found


def _part(
    sampled: Sampled, base: Sequence[Columns], beside: Sequence[Columns], rows: Index
) -> Bordered:
    apart = taken_apart(sampled, [*base, *beside], rows)
    starts, b = starts_of(beside), sum(block.size for block in base)
    starts = starts + b
    across, whole = np.zeros((b, starts[-1])), np.zeros(starts[-1])
    own = [np.zeros((last - first,) * 2) for first, last in pairwise(starts)]

    for place, product in apart.products:
        order = np.argsort(place)
        columns, made = place[order], product[np.ix_(order, order)]
        n = int(np.searchsorted(columns, b))
        across[np.ix_(columns[:n], columns)] += made[:n]
        whole[columns] += np.diag(made)
        for mine, some in _within(own, starts, columns):
            np.add(mine, made[some, some], out=mine)
    force = apart.six.shape[1]
    for lost, place in ((apart.six, apart.place[:force]), (apart.three, apart.place)):
        order = np.argsort(place)
        columns, taken = place[order], np.take(lost, order, axis=1)
        n = int(np.searchsorted(columns, b))
        across[np.ix_(columns[:n], columns)] -= taken[:, :n].T @ taken
        for mine, some in _within(own, starts, columns):
            np.subtract(mine, taken[:, some].T @ taken[:, some], out=mine)
    return Bordered(
        Gram(across[:, :b].copy(), apart.along[:b], apart.power, apart.numbers, whole[:b]),
        across[:, b:].copy(), tuple(own), apart.along[b:], whole[b:],
    )  # fmt: skip


def _within(own: list[Array], starts: Index, columns: Index) -> list[tuple[Array, slice]]:
    """Of columns, sorted, the parts of the blocks' own matrices that belong to them, with where
    they are; a triad's columns of a block lie side by side."""
    found = []
    for j, (low, high) in enumerate(pairwise(np.searchsorted(columns, starts))):
        if low < high:
            at = slice(columns[low] - starts[j], columns[high - 1] + 1 - starts[j])
            found.append((own[j][at, at], slice(low, high)))
    return found


@dataclass(frozen=True)
class Each:
    """The blocks with the base taken out. own : (w, w) of each; along (m,); power; base : what took
    it out"""

    own: tuple[Array, ...]
    along: Array
    power: float
    base: Taking


@dataclass(frozen=True)
class Taking:
    """half : (b, q) root of the base's covariance; across : (q, m) base, in its units, per unit of
    each column; prior : (b,) inverse variances"""

    half: Array
    across: Array
    prior: Array

    def carry(self, first: int) -> Array:
        """(first, m) the base's first coordinates per unit of each column."""
        return np.asarray(self.half[:first] @ self.across)

    def out_of_noise(
        self, base: Array, along: Array, power: Array, rng: np.random.Generator
    ) -> tuple[Array, Array]:
        """Products (m, n) of the columns with simulated noise, and its power (n,), with the base
        and what is believed of it taken out; base : (b, n) and along : (m, n) before."""
        believed = rng.standard_normal(base.shape) * (self.prior > 0.0)[:, None]
        right = self.half.T @ (base + np.sqrt(self.prior)[:, None] * believed)
        power = power + np.sum(believed**2, axis=0) - np.sum(right**2, axis=0)
        return along - self.across.T @ right, power


def each_beside(found: Bordered, prior: Array, pull: Array) -> Each:
    """prior, pull : (b,) as in `reduced`"""
    half = inverse_root(found.base.matrix + np.diag(prior))
    across = half.T @ found.across
    right = half.T @ (found.base.along - pull)
    ends = np.cumsum([len(own) for own in found.own])[:-1]
    parts = np.split(across, ends, axis=1)
    own = tuple(a - b.T @ b for a, b in zip(found.own, parts, strict=True))
    power = found.base.power - float(right @ right)
    return Each(own, found.along - across.T @ right, power, Taking(half, across, prior))


def noise_products(
    sampled: Sampled, blocks: Sequence[Columns], rows: Index, rng: np.random.Generator, count: int
) -> tuple[Array, Array]:
    """Products (M, count) of all columns with simulated noise of the stated weights, the motion of
    every sample taken out, and the power (count,) that is left of it."""
    along, power = np.zeros((int(starts_of(blocks)[-1]), count)), np.zeros(count)
    for a in range(0, len(rows), _ROWS):
        some = rows[a : a + _ROWS]
        arms = _arms(sampled, some)
        white = rng.standard_normal((len(arms), len(some), 3, count))
        nine = sum(np.matmul(arm.transpose(0, 2, 1), z) for arm, z in zip(arms, white, strict=True))
        for k, arm in enumerate(arms):
            white[k] -= np.matmul(arm, nine)
        power += np.einsum("ktid,ktid->d", white, white)
        _add_products(along, sampled, blocks, some, white.reshape(len(arms), -1, count))
    return along, power


def _arms(sampled: Sampled, rows: Index) -> list[Array]:
    """(rows, 3, 9) of each accelerometer and then of each gyro, whitened: what a motion of unit
    covariance adds to its readings."""
    root, force, rate = sampled.root[rows], sampled.weights.acceleration, sampled.weights.rate
    own = [np.matmul(sampled.arms[rows, k], root) for k in range(force.shape[1])]
    return [
        arms * np.sqrt(weight[rows, k])[:, None, None]
        for weight, every in ((force, own), (rate, [root[:, 6:]] * len(own)))
        for k, arms in enumerate(every)
    ]


def _add_products(
    along: Array, sampled: Sampled, blocks: Sequence[Columns], rows: Index, white: Array
) -> None:
    """white : (2 K, 3 rows, count), accelerometers first"""
    starts, triads = starts_of(blocks), len(white) // 2
    for k, noise in enumerate(white):
        gyro, triad = divmod(k, triads)
        weight = sampled.weights.rate if gyro else sampled.weights.acceleration
        mine = [j for j, block in enumerate(blocks) if block.gyro == bool(gyro)]
        widths = [blocks[j].basis.shape[3] for j in mine]
        x = np.empty((len(rows), 3, sum(widths)))
        bases = [blocks[j].basis for j in mine]
        side_by_side(bases, triad, rows, np.sqrt(weight[rows, triad]), x)
        made = x.reshape(3 * len(rows), -1).T @ noise
        for j, width, part in zip(mine, widths, np.split(made, np.cumsum(widths)), strict=False):
            at = starts[j] + (0 if blocks[j].shared else triad * width)
            along[at : at + width] += part
