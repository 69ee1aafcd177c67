"""Evidence of many candidates on thousands of independent observations.

All that the evidence needs of the data is each candidate's projection and the total power. For
independent noise both can be drawn directly: with G the Gram matrix of the projected columns,
Gᵀz is normal with covariance G and the power beside them is chi-square. So a simulated data set
costs as many numbers as there are columns, whatever the length of the recording. Where there are
more columns than observations it is the observations that are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.estimators.contest import (
    Contest,
    GramEvidence,
    Null,
    best_of_null,
    directions,
    directions_of,
    with_single,
)

_ROWS = 512  # observations that are worked on at a time


def gram_evidence(
    residual: Array,
    jacobian: Array,
    blocks: Sequence[Array],
    tau: Array,
    rng: np.random.Generator,
    draws: int,
    unit: float = 1.0,
    parts: Sequence[int] = (),
) -> GramEvidence:
    """residual (N,) and jacobian (N, p) in units of the noise, blocks (N, m_k) in units of which
    the noise is `unit`; N > p; parts : the blocks of which a single number may be all."""
    basis = np.linalg.qr(jacobian)[0]
    rest = residual - basis @ (basis.T @ residual)
    starts = np.cumsum([0] + [b.shape[1] for b in blocks])
    freedom, power = residual.size - basis.shape[1], float(rest @ rest)
    whole = [np.arange(first, last) for first, last in pairwise(starts)]
    indices, owner = with_single(whole, parts)
    if starts[-1] > freedom:
        return _wide_evidence(
            basis, rest, blocks=blocks, indices=indices, owner=owner, tau=tau, rng=rng,
            draws=draws, unit=unit,
        )  # fmt: skip
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
        owner=owner,
        tau=tau,
        rng=rng,
        draws=draws,
    )


def _wide_evidence(
    basis: Array, rest: Array, *, blocks: Sequence[Array], indices: Sequence[Index],
    owner: Sequence[int], tau: Array, rng: np.random.Generator, draws: int, unit: float,
) -> GramEvidence:  # fmt: skip
    """With more columns than observations: no matrix of the size of the columns squared, and data
    of as many directions as there are left."""
    columns = np.concatenate(list(blocks), axis=1) / unit
    whole = np.array([float(np.sum(columns[:, at] ** 2)) for at in indices[: len(blocks)]])
    columns -= basis @ (basis.T @ columns)

    def null(count: int) -> tuple[Array, Array]:
        white = rng.standard_normal((len(rest), count))
        white -= basis @ (basis.T @ white)
        return columns.T @ white, np.einsum("ij,ij->j", white, white)

    size, turns = directions_of([columns[:, at].T @ columns[:, at] for at in indices])
    return _judged(
        size=size, turns=turns,
        along=columns.T @ rest, power=float(rest @ rest), whole=whole, blocks=indices, owner=owner,
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
    owner: Sequence[int] = (),
) -> GramEvidence:
    """The same from the products alone: gram (M, M) and along (M,) of the projected columns, the
    residual's power and freedom, the blocks as indices of columns (a column may stand in several),
    and the squared size (k,) of each block before anything was taken out of it; owner : as in
    `Contest`, of the blocks after those k."""
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
        whole=whole, blocks=blocks, owner=owner, freedom=freedom, tau=tau, null=null, draws=draws,
    )  # fmt: skip


def _judged(
    *, size: Array, turns: list[Array], along: Array, power: float, whole: Array,
    blocks: Sequence[Index], owner: Sequence[int], freedom: int, tau: Array, null: Null, draws: int,
) -> GramEvidence:  # fmt: skip
    """size, turns : of all blocks, as `directions` tells them; null : data that lack nothing."""
    contest = Contest(blocks, size, turns, freedom, tau, owner)
    return contest.told(along, power, whole, best_of_null(contest, null, draws))


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
