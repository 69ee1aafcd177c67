"""Evidence of many candidates on thousands of independent observations.

All that the evidence needs of the data is each candidate's projection and the total power. For
independent noise both can be drawn directly: with G the Gram matrix of the projected columns,
Gᵀz is normal with covariance G and the power beside them is chi-square. So a simulated data set
costs as many numbers as there are columns, whatever the length of the recording. Where there are
more columns than observations it is the observations that are drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen

#: (draws) -> projections (M, draws) of data that lack nothing, and their powers (draws,).
Null = Callable[[int], tuple[Array, Array]]
#: Squared size of a block's direction over its largest from which it is more than rounding.
_OPEN = 1e-8
#: Observations, simulated data sets, and blocks of one width, that are worked on at a time.
_ROWS, _DRAWS, _BLOCKS = 512, 256, 32


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
    unit: float = 1.0,
) -> GramEvidence:
    """residual (N,) and jacobian (N, p) in units of the noise, blocks (N, m_k) in units of which
    the noise is `unit`; N > p."""
    basis = np.linalg.qr(jacobian)[0]
    rest = residual - basis @ (basis.T @ residual)
    starts = np.cumsum([0] + [b.shape[1] for b in blocks])
    freedom, power = residual.size - basis.shape[1], float(rest @ rest)
    indices = [np.arange(first, last) for first, last in pairwise(starts)]
    if starts[-1] > freedom:
        return _wide_evidence(
            basis, rest, blocks=blocks, indices=indices, tau=tau, rng=rng, draws=draws, unit=unit
        )
    inside = np.concatenate([basis.T @ b for b in blocks], axis=1) / unit
    size, gram, along = np.zeros(starts[-1]), np.zeros((starts[-1],) * 2), np.zeros(starts[-1])
    for a in range(0, len(residual), _ROWS):  # in parts: no second copy of all columns
        part = slice(a, a + _ROWS)
        columns = np.concatenate([b[part] for b in blocks], axis=1)
        columns /= unit
        size += np.einsum("ij,ij->j", columns, columns)
        columns -= basis[part] @ inside
        gram += columns.T @ columns
        along += columns.T @ rest[part]
    return block_evidence(
        gram=gram,
        along=along,
        power=power,
        freedom=freedom,
        whole=np.add.reduceat(size, starts[:-1]),
        blocks=indices,
        tau=tau,
        rng=rng,
        draws=draws,
    )


def _wide_evidence(
    basis: Array, rest: Array, *, blocks: Sequence[Array], indices: Sequence[Index], tau: Array,
    rng: np.random.Generator, draws: int, unit: float,
) -> GramEvidence:  # fmt: skip
    """With more columns than observations: no matrix of the size of the columns squared, and data
    of as many directions as there are left."""
    columns = np.concatenate(list(blocks), axis=1) / unit
    whole = np.array([float(np.sum(columns[:, at] ** 2)) for at in indices])
    columns -= basis @ (basis.T @ columns)

    def null(count: int) -> tuple[Array, Array]:
        white = rng.standard_normal((len(rest), count))
        white -= basis @ (basis.T @ white)
        return columns.T @ white, np.einsum("ij,ij->j", white, white)

    own = [_turned(columns[:, at].T @ columns[:, at]) for at in indices]
    return _judged(
        size=np.concatenate([size for size, _ in own]), turns=[turn for _, turn in own],
        along=columns.T @ rest, power=float(rest @ rest), whole=whole, blocks=indices,
        freedom=len(rest) - basis.shape[1], tau=tau, null=null, draws=draws,
    )  # fmt: skip


def block_evidence(
    gram: Array,
    along: Array,
    power: float,
    freedom: int,
    whole: Array,
    blocks: Sequence[Index],
    tau: Array,
    rng: np.random.Generator,
    draws: int,
) -> GramEvidence:
    """The same from the products alone: gram (M, M) and along (M,) of the projected columns, the
    residual's power and freedom, the blocks as indices of columns (a column may stand in several),
    and the squared size (k,) of each block before anything was taken out of it."""
    white, root, powers = _null(gram, freedom, rng, draws)
    done = 0

    def null(count: int) -> tuple[Array, Array]:
        nonlocal done
        part = slice(done, done + count)
        done += count
        return root @ white[:, part], powers[part]

    size, turns = directions(gram, blocks)
    return _judged(
        size=size, turns=turns, along=along, power=power,
        whole=whole, blocks=blocks, freedom=freedom, tau=tau, null=null, draws=draws,
    )  # fmt: skip


def _judged(
    *, size: Array, turns: list[Array], along: Array, power: float, whole: Array,
    blocks: Sequence[Index], freedom: int, tau: Array, null: Null, draws: int,
) -> GramEvidence:  # fmt: skip
    """size, turns : of all blocks, as `directions` tells them; null : data that lack nothing."""
    starts = np.cumsum([0] + [len(b) for b in blocks])
    seen = np.concatenate([turn.T @ along[b] for b, turn in zip(blocks, turns, strict=True)]) ** 2
    found = best_evidence(seen[:, None], np.array([power]), size, starts[:-1], freedom, tau)[:, 0]
    best = np.zeros(draws)
    for a in range(0, draws, _DRAWS):
        data, powers = null(min(_DRAWS, draws - a))
        square = np.square(
            np.concatenate([turn.T @ data[b] for b, turn in zip(blocks, turns, strict=True)])
        )
        best[a : a + _DRAWS] = best_evidence(
            square, powers, size, starts[:-1], freedom, tau
        ).max(axis=0)  # fmt: skip
    kept = np.add.reduceat(size, starts[:-1])
    left = kept / np.maximum(whole, 1e-300)
    rank = np.add.reduceat((size > 0.0).astype(float), starts[:-1])
    gone = np.add.reduceat(seen, starts[:-1]) / max(power, 1e-300)
    share = 1.0 - (1.0 - gone) * freedom / np.maximum(freedom - rank, 1.0)
    return GramEvidence(found, left, np.sqrt(kept), np.maximum(share, 0.0), best)


def directions(gram: Array, blocks: Sequence[Index]) -> tuple[Array, list[Array]]:
    """Squared sizes (M,) of each block's singular directions, and the matrices (m, m) that turn
    its columns into those directions at unit length."""
    sizes, turns = [np.zeros(0)] * len(blocks), [np.zeros((0, 0))] * len(blocks)
    width = np.array([len(block) for block in blocks])
    for m in np.unique(width):  # blocks of one width at once: a scan has hundreds
        same = np.flatnonzero(width == m)
        rows = np.stack([blocks[int(k)] for k in same])
        values, vectors = eigen(gram[rows[:, :, None], rows[:, None, :]])
        use = values > _OPEN * np.maximum(values[:, -1:], 1e-300)
        kept = np.where(use, values, 0.0)
        unit = np.where(use, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
        for k, size, turn in zip(same, kept, vectors * unit[:, None], strict=True):
            sizes[k], turns[k] = size, turn
    return np.concatenate(sizes), turns


def _turned(gram: Array) -> tuple[Array, Array]:
    """The same (m,) and (m, m) of one block, from its own Gram matrix."""
    values, vectors = eigen(gram)
    use = values > _OPEN * max(float(values[-1]), 1e-300)
    turn = vectors * np.where(use, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
    return np.where(use, values, 0.0), turn


def _null(
    gram: Array, freedom: int, rng: np.random.Generator, draws: int
) -> tuple[Array, Array, Array]:
    """White numbers (M, draws), the root (M, M) that gives them the columns' covariance, and the
    powers (draws,) of data that lack nothing."""
    length = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    correlation = gram / length[:, None]
    correlation /= length
    root = _root(correlation)
    root *= length[:, None]
    white = rng.standard_normal((len(gram), draws))
    beside = rng.chisquare(max(freedom - len(gram), 1), draws)
    return white, root, np.einsum("ij,ij->j", white, white) + beside


def _root(correlation: Array) -> Array:
    """Cholesky factor, in the place of the matrix: of many columns a copy would be large. Rounding
    and absorbed columns need a little on the diagonal."""
    from scipy.linalg.lapack import dpotrf

    own, every = np.diag(correlation).copy(), range(len(correlation))
    for jitter in 10.0 ** np.arange(-13.0, -4.0):
        np.fill_diagonal(correlation, own + jitter)
        # What is the upper half to the library, which counts by columns, is the lower one here.
        _, failed = dpotrf(correlation.T, lower=False, clean=False, overwrite_a=True)
        if not failed:
            for i in every:
                correlation[i, i + 1 :] = 0.0
            return correlation
        for i in every:
            correlation[i, :i] = correlation[:i, i]
    np.fill_diagonal(correlation, own)
    values, vectors = eigen(correlation)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def best_evidence(
    explained: Array, power: Array, size: Array, starts: NDArray[np.intp], freedom: int, tau: Array
) -> Array:
    """(k, draws) evidence, the maximum over τ."""
    ends = np.append(starts[1:], len(size))
    width = ends - starts
    found = np.empty((len(starts), explained.shape[1]))
    for m in np.unique(width):  # blocks of one width at once, and few enough to stay near
        same = np.flatnonzero(width == m)
        for a in range(0, len(same), _BLOCKS):
            some = same[a : a + _BLOCKS]
            rows = starts[some, None] + np.arange(m)
            gain = tau[:, None] ** 2 * size[rows][:, None]
            drop = np.matmul(gain / (1.0 + gain), explained[rows])
            rest = np.maximum(power - drop, 1e-300)
            penalty = np.log1p(gain).sum(axis=2)[:, :, None]
            found[some] = np.min(freedom * np.log(rest) + penalty, axis=1)
    return np.asarray(-0.5 * (found - freedom * np.log(power)))
