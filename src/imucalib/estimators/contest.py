"""The evidence of blocks of columns from their products with a residual and within themselves.

A block has a Gaussian prior of its physical size, times the size τ that suits the data best; the
noise is as large as the residual says. `best_of_null` tells what the best of all blocks reaches on
data that lack nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen

#: (draws) -> projections (M, draws) of data that lack nothing, and their powers (draws,).
Null = Callable[[int], tuple[Array, Array]]
#: Squared size of a block's direction over its largest from which it is more than rounding.
_OPEN = 1e-8
#: Prior that all numbers of a block are there. Of sheets at λ 5.5 a half, two thirds and this found
#: 37, 36 and 36 of 50 effects of one axis (32 by the whole block alone) and 36 of 50 of all axes;
#: what it costs an effect of all axes is a fifth of a nat, where a half costs 0.7.
_WHOLE = 0.8
#: Simulated data sets, and blocks of one width, that are worked on at a time.
_DRAWS, _BLOCKS = 256, 32


@dataclass(frozen=True)
class GramEvidence:
    """Per candidate (k,): evidence in nats, share of the columns left, λ at typical size, share of
    the power explained; best : (draws,) the best candidate's evidence on data that lack nothing."""

    evidence: Array
    left: Array
    strength: Array
    share: Array
    best: Array


@dataclass(frozen=True)
class Contest:
    """Blocks of columns that stand for the same residual, with what else is fitted taken out.

    blocks : indices of the columns, of which one may stand in several; size, turns : of all blocks,
    as `directions` tells them; tau : sizes that are tried, in typical ones
    owner : of the last blocks, which are single columns, the block whose only number each may be
    """

    blocks: Sequence[Index]
    size: Array
    turns: Sequence[Array]
    freedom: int
    tau: Array
    owner: Sequence[int] = ()

    @property
    def starts(self) -> Index:
        return np.cumsum([0] + [len(b) for b in self.blocks])[:-1].astype(np.intp)

    def seen(self, along: Array) -> Array:
        """Squared projections (directions, n) of n residuals, by products (M, n) of the columns."""
        parts = zip(self.blocks, self.turns, strict=True)
        return np.asarray(np.square(np.concatenate([turn.T @ along[b] for b, turn in parts])))

    def evidence(self, along: Array, power: Array) -> Array:
        """(k, n) nats of k blocks; along : (M, n); power : (n,) of the residuals."""
        seen = self.seen(along)
        nats = best_evidence(seen, power, self.size, self.starts, self.freedom, self.tau)
        return whole_or_one(nats, self.owner)

    def told(self, along: Array, power: float, whole: Array, best: Array) -> GramEvidence:
        """Of one residual (M,); whole : (k,) squared size of each block before anything was taken
        out; best : (draws,) as in `GramEvidence`"""
        found = self.evidence(along[:, None], np.array([power]))[:, 0]
        starts = self.starts
        kept = np.add.reduceat(self.size, starts)[: len(whole)]
        left = kept / np.maximum(whole, 1e-300)
        rank = np.add.reduceat((self.size > 0.0).astype(float), starts)[: len(whole)]
        seen = np.add.reduceat(self.seen(along[:, None])[:, 0], starts)[: len(whole)]
        gone = seen / max(power, 1e-300)
        share = 1.0 - (1.0 - gone) * self.freedom / np.maximum(self.freedom - rank, 1.0)
        return GramEvidence(found, left, np.sqrt(kept), np.maximum(share, 0.0), best)

    def beyond_chance(self, draws: int) -> float:
        """Nats that the best block does not reach on any of `draws` data sets that lack nothing,
        but for one search in a thousand: of such data the odds of a size have mean one, whatever
        the noise, and so reach exp(x) in a share exp(-x) at most (Markov's inequality)."""
        return float(np.log(1e3 * draws * len(self.tau) * max(len(self.blocks), 1)))


def with_single(blocks: Sequence[Index], parts: Sequence[int]) -> tuple[list[Index], list[int]]:
    """The blocks, and behind them the single columns of those (`parts`, by number) of which one
    number may be all; and of each single column its block."""
    several = [k for k in parts if len(blocks[k]) > 1]
    single = [np.array([column]) for k in several for column in blocks[k]]
    return [*blocks, *single], [k for k in several for _ in blocks[k]]


def whole_or_one(nats: Array, owner: Sequence[int]) -> Array:
    """(k, n) nats of k blocks of which a single number may be all, as where one axis alone has an
    effect: most of the prior is the whole block's, the rest that of one of its columns, whichever.

    nats : (k + len(owner), n), the blocks' and then those of single columns, each of its owner
    """
    found, of = nats[: len(nats) - len(owner)].copy(), np.array(owner, np.intp)
    for k in np.unique(of):
        alone = nats[len(found) :][of == k]
        one = np.logaddexp.reduce(alone, axis=0) - np.log(len(alone))
        found[k] = np.logaddexp(np.log(_WHOLE) + found[k], np.log1p(-_WHOLE) + one)
    return found


def best_of_null(contest: Contest, null: Null, draws: int) -> Array:
    """(draws,) the best evidence on data that lack nothing."""
    counts = [min(_DRAWS, draws - a) for a in range(0, draws, _DRAWS)]
    best = [contest.evidence(*null(count)).max(axis=0) for count in counts]
    return np.concatenate([np.zeros(0), *best])


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
