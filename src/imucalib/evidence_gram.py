"""Evidence of many candidates on thousands of independent observations.

All that the evidence needs of the data is each candidate's projection and the total power. For
independent noise both can be drawn directly: with G the Gram matrix of the projected columns,
Gᵀz is normal with covariance G and the power beside them is chi-square. So a simulated data set
costs as many numbers as there are columns, whatever the length of the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class GramEvidence:
    """Per candidate (k,): evidence in nats, share of the columns left, λ at typical size, share of
    the power explained; best : (draws,) the best candidate's evidence on data that lack nothing."""

    evidence: Array
    left: Array
    strength: Array
    share: Array
    best: Array


def gram_evidence(
    residual: Array,
    jacobian: Array,
    blocks: Sequence[Array],
    tau: Array,
    rng: np.random.Generator,
    draws: int,
) -> GramEvidence:
    """residual (N,), jacobian (N, p) and blocks (N, m_k) in units of the noise; N > p."""
    basis = np.linalg.qr(jacobian)[0]
    rest = residual - basis @ (basis.T @ residual)
    starts = np.cumsum([0] + [b.shape[1] for b in blocks])
    columns = np.concatenate(blocks, axis=1)
    whole = np.add.reduceat(np.einsum("ij,ij->j", columns, columns), starts[:-1])
    inside = basis.T @ columns
    for a in range(0, len(columns), 1024):  # in place: no second copy of all columns
        columns[a : a + 1024] -= basis[a : a + 1024] @ inside
    gram, along = columns.T @ columns, columns.T @ rest
    size, turn = _directions(gram, starts)
    freedom, power = residual.size - basis.shape[1], float(rest @ rest)
    null, null_power = _null(turn.T @ gram @ turn, freedom, rng, draws)
    explained = np.column_stack([(turn.T @ along) ** 2, null**2])
    powers = np.concatenate([[power], null_power])
    found = _best(explained, powers, size, starts[:-1], freedom, tau)
    kept = np.add.reduceat(size, starts[:-1])
    left = kept / np.maximum(whole, 1e-300)
    rank = np.add.reduceat((size > 0.0).astype(float), starts[:-1])
    gone = np.add.reduceat(explained[:, 0], starts[:-1]) / max(power, 1e-300)
    share = 1.0 - (1.0 - gone) * freedom / np.maximum(freedom - rank, 1.0)
    return GramEvidence(
        found[:, 0], left, np.sqrt(kept), np.maximum(share, 0.0), found[:, 1:].max(axis=0)
    )


def _directions(gram: Array, starts: NDArray[np.intp]) -> tuple[Array, Array]:
    """Squared sizes (M,) of each block's singular directions, and the matrix (M, M), block by
    block, that turns columns into those directions at unit length."""
    size, turn = np.zeros(len(gram)), np.zeros_like(gram)
    for first, last in pairwise(starts):
        part = slice(first, last)
        values, vectors = np.linalg.eigh(gram[part, part])
        use = values > 1e-10 * max(float(values[-1]), 1e-300)
        size[part] = np.where(use, values, 0.0)
        turn[part, part] = vectors * np.where(use, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    return size, turn


def _null(
    correlation: Array, freedom: int, rng: np.random.Generator, draws: int
) -> tuple[Array, Array]:
    """Projections (M, draws) and powers (draws,) of data that lack nothing."""
    values, vectors = np.linalg.eigh(correlation)
    use = values > 1e-9 * max(float(values[-1]), 1e-300)
    white = rng.standard_normal((int(use.sum()), draws))
    beside = rng.chisquare(max(freedom - int(use.sum()), 1), draws)
    root = vectors[:, use] * np.sqrt(values[use])
    return root @ white, np.einsum("ij,ij->j", white, white) + beside


def _best(
    explained: Array, power: Array, size: Array, starts: NDArray[np.intp], freedom: int, tau: Array
) -> Array:
    """(k, 1 + draws) evidence, the maximum over τ."""
    base = -0.5 * freedom * np.log(power)
    best: Array = np.full((len(starts), explained.shape[1]), -np.inf)
    for factor in tau:
        gain = factor**2 * size
        drop = np.add.reduceat((gain / (1.0 + gain))[:, None] * explained, starts, axis=0)
        penalty = np.add.reduceat(np.log1p(gain), starts)[:, None]
        rest = np.maximum(power - drop, 1e-300)
        np.maximum(best, -0.5 * (freedom * np.log(rest) + penalty) - base, out=best)
    return best
