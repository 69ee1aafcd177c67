"""Evidence of candidates where settings have errors, maximised over a grid of noise hypotheses.

Each point of the grid fixes the ratios of the settings' scatter to the noise; the noise itself is
profiled in closed form. What depends on the data is separate from what does not, so simulated
data sets can follow in parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.core.restricted import Covariances, restricted
from imucalib.estimators.contest import whole_or_one, with_single

#: Sizes of a candidate, in its typical size, over which the evidence is maximised.
TAU = np.array([0.1, 0.3, 1.0, 3.0, 10.0])
#: Variance components are re-estimated on this grid of factors of the fitted ratio. The fitted
#: ratio itself is left out: the data would sit on a grid point and simulated data beside one.
SHRINK = (0.0, 0.15, 0.4, 0.72, 0.92, 1.15, 1.6)
#: The same beside noise that neighbours share, and inside folds.
_COARSE = (0.0, 0.4, 0.92, 1.6)
#: The same of what sessions share: effects within a session do not explain it.
HELD = (0.92,)
#: The same of the excess of an axis.
EXCESS = (0.0, 0.92)
#: Numbers that are held, and that are worked on, at a time.
_NUMBERS, _CACHED = 2_000_000, 100_000
#: A squared size below this share of what the block has before the settings take theirs of it, and
#: a power below this share of the whole, is rounding.
_ROUNDING = 1e-11


def _kind(data: Array) -> type[np.floating]:
    """Of many data sets (n, D) single precision: a thousandth of a nat, at half the time."""
    return np.float32 if data.shape[1] > 1 else np.float64


@dataclass(frozen=True)
class _Blocks:
    """The blocks of one width, k of them with m columns each, under P noise hypotheses.

    which : (k,) of the candidates; at : (k, m) their columns; turn : (P, k, m, m) from projections
    to parts along the singular directions; share : (P, k, TAU, m) of each part's square that a
    block of size τ explains; weight : (P, k, TAU, 1) what the restricted likelihood's determinants
    cost, as a factor of the power that is left
    """

    which: Index
    at: Index
    turn: Array
    share: Array
    weight: Array

    def left(self, power: Array, projection: Array) -> Array:
        """(k, data sets) of the power left beside each block, at its best size and noise."""
        kind = _kind(power)
        times = np.multiply if self.at.shape[1] == 1 else np.matmul
        best = np.full((len(self.which), power.shape[1]), np.inf)
        step = max(1, _CACHED // (self.share.shape[2] * best.size))
        for part in (slice(a, a + step) for a in range(0, len(power), step)):
            explained = np.square(times(self.turn[part].astype(kind), projection[part][:, self.at]))
            explained /= power[part, None, None].astype(kind)
            weight = self.weight[part].astype(kind)
            rest = times((self.weight[part] * self.share[part]).astype(kind), explained)
            np.subtract(weight, rest, out=rest)
            least = np.maximum(rest.min(axis=2), _ROUNDING * weight.min(axis=2))
            np.minimum(best, (power[part, None] * least).min(axis=0), out=best)
        return best


@dataclass(frozen=True)
class _Part:
    """Noise hypotheses, P times F; weight : (P F, 1) what each costs where no candidate is added.

    rest, along : all candidates' columns, split as the covariances do, (P, n, c) and (P, f, c)
    """

    covariances: Covariances
    rest: Array
    along: Array
    blocks: tuple[_Blocks, ...]
    weight: Array

    @property
    def size(self) -> int:
        return len(self.weight)

    def against(self, data: Array) -> tuple[Array, Array]:
        """Power (P F, D) of data (n, D), and its projection (P F, c, D) on the columns."""
        rest, along = self.covariances.split(data)
        weighted = self.covariances.weight[..., None] * along[:, None]
        power = (rest**2).sum(axis=1)[:, None] + (weighted * along[:, None]).sum(axis=2)
        kind = _kind(data)
        one = self.rest.astype(kind).swapaxes(-1, -2) @ rest.astype(kind)
        two = self.along.astype(kind).swapaxes(-1, -2)[:, None] @ weighted.astype(kind)
        projection = one[:, None] + two
        return power.reshape(self.size, -1), projection.reshape(self.size, -1, data.shape[1])


class EvidenceGrid:
    """Blocks of columns against data sets, all in units of the fitted noise factor.

    jacobian : (N, p) of the fitted parameters; settings : the components' matrices N_c
    ratio : fitted sd of each component over the noise factor
    blocks : (N, m_k) columns of each candidate at typical size
    without : the same ratios where the last component, noise that neighbours share, is left out: it
        may have taken over what a candidate explains, and the other components with it
    parts : the blocks, by number, of which a single number may be all
    coarse : fewer hypotheses of the noise, for a part of data whose whole has been searched, and
        beside a number a reading, whose many columns make each cost ten times as much
    held : factors of the components, by number, that have few of their own
    """

    def __init__(
        self,
        jacobian: Array,
        settings: tuple[Array, ...],
        ratio: tuple[float, ...],
        blocks: Sequence[Array],
        without: tuple[float, ...] | None = None,
        coarse: bool = False,
        held: Mapping[int, tuple[float, ...]] | None = None,
        parts: Sequence[int] = (),
    ) -> None:
        left = restricted(jacobian, settings)
        self._turned, self._freedom = left.turned, left.freedom
        self._columns = left.turned(np.column_stack(blocks))
        starts = np.cumsum([0] + [b.shape[1] for b in blocks])
        whole = [np.arange(first, last) for first, last in pairwise(starts)]
        spans, self._owner = with_single(whole, parts)
        shrink = _COARSE if coarse else SHRINK
        points = _around(ratio, shrink if without is None else _COARSE, held)
        if without is not None:
            points += [(*point, 0.0) for point in _around(without, shrink, held)]
        width = np.array([len(span) for span in spans])
        same = [
            (which, np.stack([spans[k] for k in which]))
            for which in (np.flatnonzero(width == m) for m in np.unique(width))
        ]
        self._size = len(spans)
        distinct = np.array(list(dict.fromkeys(points)), np.float64)
        each = len(left.out) + len(SHRINK) * left.columns.shape[1]
        at = list(left.over(distinct, max(1, _NUMBERS // (each * self._columns.shape[1]))))
        lowest = min(float(some.log_det.min()) for some in at)
        self._parts = [_part(some, self._columns, same, lowest, self._freedom) for some in at]

    def evidence(self, data: Array) -> Array:
        """(candidates, data sets) evidence in nats of data (N, data sets)."""
        return whole_or_one(self._spans(data), self._owner)

    def _spans(self, data: Array) -> Array:
        data = self._turned(data)
        most = max(part.size for part in self._parts) * self._columns.shape[1]
        step = max(1, _NUMBERS // most)
        found = [self._evidence(data[:, a : a + step]) for a in range(0, data.shape[1], step)]
        return np.concatenate(found, axis=1)

    def _evidence(self, data: Array) -> Array:
        """A likelihood at its best noise is a power of what is left: the least over all hypotheses
        and sizes is found first, and turned into nats once."""
        nothing: Array = np.full(data.shape[1], np.inf)
        best: Array = np.full((self._size, data.shape[1]), np.inf)
        for part in self._parts:
            power, projection = part.against(data)
            np.minimum(nothing, (part.weight * power).min(axis=0), out=nothing)
            for blocks in part.blocks:
                least = np.minimum(best[blocks.which], blocks.left(power, projection))
                best[blocks.which] = least
        return np.asarray(0.5 * self._freedom * (np.log(nothing) - np.log(best)))


def _around(
    ratio: tuple[float, ...],
    shrink: tuple[float, ...],
    held: Mapping[int, tuple[float, ...]] | None,
) -> list[tuple[float, ...]]:
    each = ((held or {}).get(k, shrink) for k in range(len(ratio)))
    sizes = zip(ratio, each, strict=True)
    return list(product(*(tuple(dict.fromkeys(s * r for s in some)) for r, some in sizes)))


def _part(
    covariances: Covariances,
    columns: Array,
    same: Sequence[tuple[Index, Index]],
    lowest: float,
    freedom: int,
) -> _Part:
    """same : of each width which candidates have it and their columns (k, m), which are decomposed
    together; lowest : of all log det V."""
    rest, along = covariances.split(columns)
    before = np.repeat(covariances.sizes(columns), covariances.log_det.shape[1], axis=0)
    cost = (covariances.log_det.reshape(-1, 1) - lowest) / freedom
    blocks = []
    for which, at in same:
        # Eigenvectors of the small Gram matrices are the blocks' singular directions.
        gram = _grams(rest, along, covariances.weight, at)
        values, vectors = eigen(gram) if at.shape[1] > 1 else (gram[..., 0], np.ones(gram.shape))
        open_ = values > _ROUNDING * before[:, at].sum(axis=2, keepdims=True)
        size = np.where(open_, values, 0.0)
        scale = np.where(open_, 1.0 / np.sqrt(np.where(open_, values, 1.0)), 0.0)
        turn = scale[..., None] * vectors.swapaxes(-1, -2)
        gain = TAU[:, None] ** 2 * size[..., None, :]
        times = cost[..., None, None] + np.log1p(gain).sum(-1, keepdims=True) / freedom
        blocks.append(_Blocks(which, at, turn, gain / (1.0 + gain), np.exp(times)))
    return _Part(covariances, rest, along, tuple(blocks), np.exp(cost))


def _grams(rest: Array, along: Array, weight: Array, at: Index) -> Array:
    """(P F, k, m, m) of blocks' columns (k, m) under every hypothesis."""
    one = rest[:, :, at].transpose(0, 2, 3, 1)
    two = along[:, :, at].transpose(0, 2, 3, 1)[:, None]
    own = (one @ one.swapaxes(-1, -2))[:, None]
    gram = own + (two * weight[:, :, None, None]) @ two.swapaxes(-1, -2)
    return np.asarray(gram.reshape(-1, *gram.shape[2:]))
