"""Candidates and data under one walk with the model taken out: what scores are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.contest import directions_of
from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Terms

#: Largest size of a curve, in typical ones, and columns that make one: its many terms would grow
#: to any size where the postures do not determine them.
CURVE_SIZE, CURVE_TERMS = 3.0, 7


@dataclass(frozen=True)
class Null:
    """Data that lack nothing: by walk their products (m, draws) with all columns, and power
    (draws,)."""

    along: dict[int, Array]
    power: dict[int, Array]
    draws: int


@dataclass(frozen=True)
class Columns:
    """Columns under one walk with the model taken out, whose products are made block by block: of
    all that a search tries hundreds of columns, few are ever held against each other.

    whole : (m, m) products over all rows; less : (r, m) rows whose products come off, the white
    ones that are not kept and those of the model; inside : (p, m) the last of these; root : (p, p)
    that made them of the model's own products; turned : `directions` by columns
    """

    whole: Array
    less: Array
    inside: Array
    root: Array
    turned: dict[bytes, tuple[Array, Array]]

    def gram(self, blocks: Index) -> Array:
        """(k, c, c) products within blocks (k, c) of columns."""
        off = self.less[:, blocks].transpose(1, 2, 0)
        kept = self.whole[blocks[:, :, None], blocks[:, None, :]]
        return np.asarray(kept - off @ off.transpose(0, 2, 1))

    def size(self, columns: Index) -> float:
        """Squared size of some columns before the model was taken out."""
        out = self.less[: len(self.less) - len(self.inside), columns]
        return float(np.diagonal(self.whole)[columns].sum() - np.sum(out**2))

    def along(self, column: int) -> Array:
        """(m,) products with one column."""
        return np.asarray(self.whole[:, column] - self.less.T @ self.less[:, column])


@dataclass(frozen=True)
class View:
    """Columns and data with the model taken out: along (m, 1 + draws), power (1 + draws,)."""

    columns: Columns
    along: Array
    power: Array


def projected(bank: Bank, terms: Terms, keep: Mask, walk: int, null: Null | None) -> View:
    columns, y = _taken_out(bank, terms, keep, walk), bank.data
    along = columns.along(y)[:, None]
    power = along[y]
    if null is not None:
        data = null.along[walk]
        own = columns.root @ data[terms.columns]
        along = np.column_stack([along, data - columns.inside.T @ own])
        power = np.concatenate([power, null.power[walk] - np.sum(own**2, axis=0)])
    return View(columns, along, np.maximum(power, 1e-300))


def _taken_out(bank: Bank, terms: Terms, keep: Mask, walk: int) -> Columns:
    """Kept of the whole data: chance asks for the same once more."""
    key = (walk, terms.columns.tobytes(), terms.precision.tobytes())
    known = bank.made.get(key) if keep.all() else None
    if isinstance(known, Columns):
        return known
    whole, out = bank.over(walk, keep)
    model = whole[terms.columns] - out[:, terms.columns].T @ out
    precise = model[:, terms.columns] + np.diag(terms.precision)
    root = np.linalg.inv(np.linalg.cholesky(precise))
    inside = root @ model
    made = Columns(whole, np.vstack([out, inside]), inside, root, {})
    if keep.all():
        bank.made[key] = made
    return made


def gains(view: View, blocks: Sequence[Index], freedom: int, sizes: Sequence[float]) -> Array:
    """(sizes, blocks) nats of the data alone, without eigenvectors: of

        log|I + τ² G| + freedom log(1 - b'(G + I/τ²)⁻¹b / power)

    both parts are in one Cholesky factor of G + I/τ² with b below it; -inf beyond a curve's."""
    along, power = view.along[:, 0], view.power[0]
    out = np.full((len(sizes), len(blocks)), -np.inf)
    width = np.array([len(columns) for columns in blocks])
    for m in np.unique(width):
        same = np.flatnonzero(width == m)
        at = np.stack([blocks[int(k)] for k in same])
        tried = np.flatnonzero((m < CURVE_TERMS) | (np.array(sizes) <= CURVE_SIZE))
        tau = np.array(sizes)[tried, None]
        block = np.empty((tau.size, same.size, m + 1, m + 1))
        block[..., :m, :m] = view.columns.gram(at)
        block[..., m, :m] = block[..., :m, m] = along[at]
        block[..., m, m] = 2.0 * power
        diagonal = np.arange(m)
        block[..., diagonal, diagonal] += tau[:, None] ** -2.0
        root = np.linalg.cholesky(block)
        volume = 2.0 * (np.log(root[..., diagonal, diagonal]).sum(axis=2) + m * np.log(tau))
        drop = np.sum(root[..., m, :m] ** 2, axis=2)
        rest = np.log(np.maximum(1.0 - drop / power, 1e-300))
        out[np.ix_(tried, same)] = -0.5 * (volume + freedom * rest)
    return out


def turned(view: View, blocks: Sequence[Index]) -> tuple[Array, Array]:
    known = view.columns.turned
    new = [columns for columns in blocks if columns.tobytes() not in known]
    if new:
        size, turns = directions_of([view.columns.gram(columns[None])[0] for columns in new])
        ends = np.cumsum([columns.size for columns in new])[:-1]
        for columns, own, turn in zip(new, np.split(size, ends), turns, strict=True):
            known[columns.tobytes()] = own, turn
    pairs = [known[columns.tobytes()] for columns in blocks]
    along = [turn.T @ view.along[columns] for columns, (_, turn) in zip(blocks, pairs, strict=True)]
    return np.concatenate([own for own, _ in pairs]), np.concatenate(along) ** 2
