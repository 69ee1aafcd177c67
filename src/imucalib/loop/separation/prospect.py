"""How often an ambiguity will have ended: data are drawn with each rival as the truth in turn, and
judged by the evidence and by the rule of aliases that the search itself uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.eigen import eigen
from imucalib.estimators.contest import best_evidence, directions
from imucalib.loop.separation.products import TAU, Ambiguity
from imucalib.loop.thresholds import APART, MARGIN


@dataclass(frozen=True)
class Drawn:
    """Data sets. along : (P, draws) with all columns; power : (draws,)"""

    along: Array
    power: Array
    numbers: float


@dataclass(frozen=True)
class Added:
    """New data. gram : (P, P) of all columns; numbers : how many data they are"""

    gram: Array
    numbers: float


def ends(
    ambiguity: Ambiguity,
    added: Added,
    rng: np.random.Generator,
    draws: int,
    against: Mapping[str, Sequence[str]],
) -> Mapping[str, float]:
    """Share of draws in which each rival, were it the truth, is named and alone.

    against : truth -> the rivals that it has to stand apart from
    """
    out = taken_out(ambiguity, ambiguity.products.gram + added.gram)
    root = _root_of(added.gram)
    return {
        truth: float(
            np.mean(
                alone(
                    ambiguity, out, _drawn(ambiguity, truth, added.numbers, root, rng, draws),
                    truth, others,
                )
            )
        )
        for truth, others in against.items()
    }  # fmt: skip


def _root_of(gram: Array) -> Array:
    """(P, r) root of the products of new data."""
    values, vectors = eigen(gram)
    use = values > 1e-12 * max(float(values[-1]), 1e-300)
    return np.asarray(vectors[:, use] * np.sqrt(values[use]))


def _drawn(
    ambiguity: Ambiguity, truth: str, numbers: float, root: Array, rng: np.random.Generator,
    draws: int,
) -> Drawn:  # fmt: skip
    """The recording as it is, and new data with sizes that it allows: their noise as uncertain as
    it has left it; numbers, root (P, r) : of the new data"""
    old = ambiguity.products
    scale = np.sqrt(ambiguity.dof / rng.chisquare(max(ambiguity.dof, 1.0), draws))
    size = ambiguity.sizes[truth]
    theta = size.drawn(rng, draws, scale)
    white = rng.standard_normal((root.shape[1], draws)) * scale
    clean = root[size.at].T @ theta
    beside = rng.chisquare(max(numbers - root.shape[1], 1e-9), draws) * scale**2
    return Drawn(
        old.along[:, None] + root @ (clean + white),
        old.power + np.sum((clean + white) ** 2, axis=0) + beside,
        old.numbers + numbers,
    )


def alone(
    ambiguity: Ambiguity, out: TakenOut, data: Drawn, truth: str, others: Sequence[str]
) -> NDArray[np.bool_]:
    """(draws,) whether the truth has the most evidence and none of the others would do as well."""
    found = [ambiguity.blocks[name] for name in (truth, *others)]
    gram, (along, power, freedom) = out.gram, out.of(data)
    nats = _nats(gram, along, power, found, freedom)
    best = nats[0]
    near = np.maximum(best - MARGIN, 0.5 * best)
    noise = _beside(gram, along, power, found[0], freedom)
    single = np.ones(best.size, dtype=bool)
    for at, other in zip(found[1:], nats[1:], strict=True):
        close = _left(gram, along, found[0], at) < APART * noise
        single &= (other < near) & ~((other >= 0.5 * best) & close)
    return single


def weights(ambiguity: Ambiguity) -> Mapping[str, float]:
    """How likely the recording makes each rival, all of them alike beforehand; sum 1."""
    p = ambiguity.products
    data = Drawn(p.along[:, None], np.array([p.power]), p.numbers)
    found = [ambiguity.blocks[name] for name in ambiguity.rivals]
    out = taken_out(ambiguity, p.gram)
    along, power, freedom = out.of(data)
    nats = _nats(out.gram, along, power, found, freedom)
    share = np.exp(nats[:, 0] - nats[:, 0].max())
    return dict(zip(ambiguity.rivals, (share / share.sum()).tolist(), strict=True))


@dataclass(frozen=True)
class TakenOut:
    """The base taken out of data with the same columns. gram : (P, P) of what it leaves; carry :
    (b, P) base per unit of each column; factor : of its own products"""

    gram: Array
    carry: Array
    factor: tuple[Array, Array]

    def of(self, data: Drawn) -> tuple[Array, Array, int]:
        """Products with the data, its power and its degrees of freedom."""
        from scipy.linalg import lu_solve

        own = data.along[: len(self.carry)]
        used = np.einsum("pd,pd->d", own, lu_solve(self.factor, own))
        power = np.maximum(data.power - used, 1e-300)
        return data.along - self.carry.T @ own, power, round(data.numbers) - len(own)


def taken_out(ambiguity: Ambiguity, gram: Array) -> TakenOut:
    """gram : (P, P) products of all columns"""
    from scipy.linalg import lu_factor, lu_solve

    own = ambiguity.own
    base = gram[np.ix_(own, own)]
    factor = lu_factor(base + np.diag(1e-10 * np.diag(base) + 1e-12))
    carry = np.asarray(lu_solve(factor, gram[own]))
    return TakenOut(gram - gram[:, own] @ carry, carry, factor)


def _nats(
    gram: Array, along: Array, power: Array, found: Sequence[Index], freedom: int
) -> Array:  # (rivals, draws)
    size, turns = directions(gram, found)
    seen = np.concatenate([turn.T @ along[at] for at, turn in zip(found, turns, strict=True)]) ** 2
    starts = np.cumsum([0, *(at.size for at in found)])[:-1].astype(np.intp)
    return best_evidence(seen, power, size, starts, freedom, TAU)


def _beside(gram: Array, along: Array, power: Array, own: Index, freedom: int) -> Array:
    """(draws,) noise that is left beside the truth."""
    inside = np.linalg.pinv(gram[np.ix_(own, own)], rcond=1e-9, hermitian=True)
    explained = np.einsum("kd,kl,ld->d", along[own], inside, along[own])
    return np.asarray(np.sqrt(np.maximum(power - explained, 1e-300) / max(freedom - own.size, 1)))


def _left(gram: Array, along: Array, own: Index, other: Index) -> Array:
    """(draws,) length of what the truth explains and another cannot."""
    inside = np.linalg.pinv(gram[np.ix_(own, own)], rcond=1e-9, hermitian=True)
    theta = inside @ along[own]
    across = gram[np.ix_(other, own)]
    apart = np.linalg.pinv(gram[np.ix_(other, other)], rcond=1e-9, hermitian=True)
    left = gram[np.ix_(own, own)] - across.T @ apart @ across
    return np.asarray(np.sqrt(np.maximum(np.einsum("kd,kl,ld->d", theta, left, theta), 0.0)))
