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
from imucalib.loop.noise.grid import TAU
from imucalib.loop.separation.products import Ambiguity
from imucalib.loop.thresholds import APART, MARGIN


@dataclass(frozen=True)
class Drawn:
    """Data sets with all columns' products. gram : (P, P); along : (P, draws); power : (draws,)"""

    gram: Array
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
    return {
        truth: float(
            np.mean(alone(ambiguity, drawn(ambiguity, truth, added, rng, draws), truth, o))
        )
        for truth, o in against.items()
    }


def drawn(
    ambiguity: Ambiguity, truth: str, added: Added, rng: np.random.Generator, draws: int
) -> Drawn:
    """The recording as it is, and new data with sizes that it allows: their noise as uncertain as
    it has left it."""
    old, gram, numbers = ambiguity.products, added.gram, added.numbers
    scale = np.sqrt(ambiguity.dof / rng.chisquare(max(ambiguity.dof, 1.0), draws))
    size = ambiguity.sizes[truth]
    theta = size.drawn(rng, draws, scale)
    values, vectors = eigen(gram)
    use = values > 1e-12 * max(float(values[-1]), 1e-300)
    root = vectors[:, use] * np.sqrt(values[use])
    white = rng.standard_normal((root.shape[1], draws)) * scale
    clean = root[size.at].T @ theta
    beside = rng.chisquare(max(numbers - root.shape[1], 1e-9), draws) * scale**2
    return Drawn(
        old.gram + gram,
        old.along[:, None] + root @ (clean + white),
        old.power + np.sum((clean + white) ** 2, axis=0) + beside,
        old.numbers + numbers,
    )


def alone(
    ambiguity: Ambiguity, data: Drawn, truth: str, others: Sequence[str]
) -> NDArray[np.bool_]:
    """(draws,) whether the truth has the most evidence and none of the others would do as well."""
    found = [ambiguity.blocks[name] for name in (truth, *others)]
    gram, along, power, freedom = _without_base(ambiguity, data)
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
    data = Drawn(p.gram, p.along[:, None], np.array([p.power]), p.numbers)
    found = [ambiguity.blocks[name] for name in ambiguity.rivals]
    nats = _nats(*_without_base(ambiguity, data)[:3], found, round(p.numbers) - ambiguity.first)
    share = np.exp(nats[:, 0] - nats[:, 0].max())
    return dict(zip(ambiguity.rivals, (share / share.sum()).tolist(), strict=True))


def _without_base(ambiguity: Ambiguity, data: Drawn) -> tuple[Array, Array, Array, int]:
    """Products, those with the data, its power and its degrees of freedom, the base taken out."""
    own = ambiguity.own
    base = data.gram[np.ix_(own, own)]
    base = base + np.diag(1e-10 * np.diag(base) + 1e-12)
    carry = np.linalg.solve(base, data.gram[own])
    gram = data.gram - data.gram[:, own] @ carry
    along = data.along - carry.T @ data.along[own]
    used = np.einsum("pd,pd->d", data.along[own], np.linalg.solve(base, data.along[own]))
    power = np.maximum(data.power - used, 1e-300)
    return gram, along, power, round(data.numbers) - len(own)


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
