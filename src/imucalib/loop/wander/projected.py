"""Candidates and data under one walk with the model taken out: what scores are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.estimators.contest import directions
from imucalib.loop.wander.bank import Bank, Mask
from imucalib.loop.wander.likelihood import Terms


@dataclass(frozen=True)
class Null:
    """Data that lack nothing: products (walks, m, draws) with all columns, and power (walks,
    draws)."""

    along: Array
    power: Array


@dataclass(frozen=True)
class Columns:
    """Columns under one walk with the model taken out: gram (m, m); inside (p, m), precise (p, p)
    the model's products; whole (m,) squared sizes before that; turned : `directions` by columns"""

    gram: Array
    inside: Array
    precise: Array
    whole: Array
    turned: dict[bytes, tuple[Array, Array]]


@dataclass(frozen=True)
class View:
    """Columns and data with the model taken out: along (m, 1 + draws), power (1 + draws,)."""

    columns: Columns
    along: Array
    power: Array


def projected(bank: Bank, terms: Terms, keep: Mask, walk: int, null: Null | None) -> View:
    columns, y = _taken_out(bank, terms, keep, walk), bank.data
    along, power = columns.gram[:, [y]], columns.gram[y, [y]]
    if null is not None:
        data = null.along[walk]
        own = np.linalg.solve(columns.precise, data[terms.columns])
        along = np.column_stack([along, data - columns.inside.T @ own])
        used = np.einsum("pd,pd->d", data[terms.columns], own)
        power = np.concatenate([power, null.power[walk] - used])
    return View(columns, along, np.maximum(power, 1e-300))


def _taken_out(bank: Bank, terms: Terms, keep: Mask, walk: int) -> Columns:
    """Kept of the whole data: chance asks for the same once more."""
    key = (walk, terms.columns.tobytes(), terms.precision.tobytes())
    known = bank.made.get(key) if keep.all() else None
    if isinstance(known, Columns):
        return known
    full = bank.train(walk, keep)
    inside = full[terms.columns]
    precise = inside[:, terms.columns] + np.diag(terms.precision)
    gram = full - inside.T @ np.linalg.solve(precise, inside)
    made = Columns(gram, inside, precise, np.diag(full), {})
    if keep.all():
        bank.made[key] = made
    return made


def gains(view: View, blocks: Sequence[Index], freedom: int, sizes: Sequence[float]) -> Array:
    """(sizes, blocks) nats of the data alone, without eigenvectors: of

        log|I + τ² G| + freedom log(1 - b'(G + I/τ²)⁻¹b / power)

    both parts are in one Cholesky factor of G + I/τ² with b below it."""
    gram, along, power = view.columns.gram, view.along[:, 0], view.power[0]
    out = np.empty((len(sizes), len(blocks)))
    width = np.array([len(columns) for columns in blocks])
    for m in np.unique(width):
        same = np.flatnonzero(width == m)
        at = np.stack([blocks[int(k)] for k in same])
        block = np.zeros((same.size, m + 1, m + 1))
        block[:, :m, :m] = gram[at[:, :, None], at[:, None, :]]
        block[:, m, :m] = block[:, :m, m] = along[at]
        block[:, m, m] = 2.0 * power
        for k, size in enumerate(sizes):
            root = np.linalg.cholesky(block + np.diag(np.append(np.full(m, size**-2.0), 0.0)))
            inside = np.diagonal(root, axis1=1, axis2=2)[:, :m]
            volume = 2.0 * (np.log(inside).sum(axis=1) + m * np.log(size))
            drop = np.sum(root[:, m, :m] ** 2, axis=1)
            rest = np.log(np.maximum(1.0 - drop / power, 1e-300))
            out[k, same] = -0.5 * (volume + freedom * rest)
    return out


def turned(view: View, blocks: Sequence[Index]) -> tuple[Array, Array]:
    known = view.columns.turned
    new = [columns for columns in blocks if columns.tobytes() not in known]
    if new:
        size, turns = directions(view.columns.gram, new)
        ends = np.cumsum([columns.size for columns in new])[:-1]
        for columns, own, turn in zip(new, np.split(size, ends), turns, strict=True):
            known[columns.tobytes()] = own, turn
    pairs = [known[columns.tobytes()] for columns in blocks]
    along = [turn.T @ view.along[columns] for columns, (_, turn) in zip(blocks, pairs, strict=True)]
    return np.concatenate([own for own, _ in pairs]), np.concatenate(along) ** 2
