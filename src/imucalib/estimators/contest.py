"""The evidence of blocks of columns from their products with a residual and within themselves.

A block has a Gaussian prior of its physical size, times the size τ that suits the data best; the
noise is as large as the residual says.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen

#: Squared size of a block's direction over its largest from which it is more than rounding.
_OPEN = 1e-8
#: Blocks of one width that are worked on at a time.
_BLOCKS = 32


def directions(gram: Array, blocks: Sequence[Index]) -> tuple[Array, list[Array]]:
    """`directions_of` the blocks of one Gram matrix."""
    return directions_of([gram[np.ix_(block, block)] for block in blocks])


def directions_of(grams: Sequence[Array]) -> tuple[Array, list[Array]]:
    """Squared sizes (M,) of each block's singular directions, and the matrices (m, m) that turn
    its columns into those directions at unit length, from each block's own Gram matrix."""
    sizes, turns = [np.zeros(0)] * len(grams), [np.zeros((0, 0))] * len(grams)
    width = np.array([len(gram) for gram in grams])
    for m in np.unique(width):  # blocks of one width at once: a scan has hundreds
        same = np.flatnonzero(width == m)
        values, vectors = eigen(np.stack([grams[int(k)] for k in same]))
        use = values > _OPEN * np.maximum(values[:, -1:], 1e-300)
        kept = np.where(use, values, 0.0)
        unit = np.where(use, 1.0 / np.sqrt(np.maximum(values, 1e-300)), 0.0)
        for k, size, turn in zip(same, kept, vectors * unit[:, None], strict=True):
            sizes[k], turns[k] = size, turn
    return np.concatenate(sizes), turns


def best_evidence(
    explained: Array, power: Array, size: Array, starts: Index, freedom: int, tau: Array
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
