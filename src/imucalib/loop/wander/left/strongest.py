"""The strongest of many ways in which something could still be missing beside what was taken.

    lead = max over walks of L(with its columns) - max over walks, slower ones too, of L

No data need be drawn. The odds of one way, size and walk have mean one where nothing is missing,
so that the chance of any lead is at most exp(-lead) times their number (Markov's inequality).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.found import Unexplained
from imucalib.loop.thresholds import MARGIN
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.scores import SIZES, beside
from imucalib.loop.wander.slow import slower, through
from imucalib.loop.wander.walk import Walk

#: Chance up to which it is told, as in `scores.sure`: no noise is just a walk of those tried.
_CHANCE = 1e-3


@dataclass(frozen=True)
class Way:
    """words : what is told; driver, kind : as `Unexplained` has them; columns : (n, c) in units of
    a run's scatter, about one in the mean; within : those of them that a search has tried, which it
    must lead; among : how many it was chosen from by the data; effect : the name of one that can
    correct it, or empty"""

    words: str
    driver: str
    kind: str
    columns: Array
    within: Array | None = None
    among: int = 1
    effect: str = ""


@dataclass(frozen=True)
class Told:
    """A way with what is told of it."""

    way: Way
    structure: Unexplained


def strongest(found: Search, *groups: Sequence[Way]) -> Told | None:
    """The likeliest way of all groups beside all that was taken, where its chance among those of
    its group is a thousandth at most."""
    ways = [way for group in groups for way in group]
    if not ways:
        return None
    ends = np.cumsum([len(group) for group in groups])[:-1]
    first = np.split(_beside_own(found, [way.columns for way in ways]), ends)
    each = (_of_group(found, group, own) for group, own in zip(groups, first, strict=True))
    told = [one for one in each if one is not None]
    return max(told, key=lambda one: one.structure.evidence, default=None)


def chance_bar(ways: int, walks: int) -> float:
    """Nats that the likeliest of so many ways reaches by a chance of a thousandth at most."""
    return float(np.log(ways * walks * len(SIZES) / _CHANCE))


def _of_group(found: Search, ways: Sequence[Way], first: Array) -> Told | None:
    """first : (ways,) nats that each gains under the noise as it is, or where that is white"""
    if not ways:
        return None
    bank = found.bank
    walks = (*bank.walks, *slower(bank))
    bar = chance_bar(sum(way.among for way in ways), len(walks))
    while True:
        best = int(np.argmax(first))
        if first[best] < bar:
            return None
        way = ways[best]
        lead = _lead(found, walks, way.columns)
        if way.within is None or lead >= _lead(found, walks, way.within) + MARGIN:
            break
        first[[one.within is not None for one in ways]] = -np.inf  # others of it are no more
    if lead < bar:
        return None
    chance = _CHANCE * float(np.exp(bar - lead))
    share = 1.0 - float(np.exp(-2.0 * lead / bank.course.time.size))
    return Told(way, Unexplained(way.words, way.driver, way.kind, chance, lead, share))


def _beside_own(found: Search, blocks: list[Array]) -> Array:
    """(blocks,) nats that each gains under the noise as it is, or where that is white."""
    bank, terms = found.bank, found.terms
    every = [bank.walks[k] for k in sorted({0, found.level.walk})]
    one = through(bank, tuple(every), np.append(terms.columns, bank.data))
    own = Terms(np.arange(terms.columns.size), terms.precision, terms.base)
    keep = np.ones(1, dtype=bool)
    nats = np.array([level.nats for level in levels(one, own, keep)])
    gains = [beside(one, own, keep, k, blocks, SIZES).max(axis=1) for k in range(len(every))]
    return np.asarray(np.max(nats[:, None] + gains, axis=0) - nats.max())


def _lead(found: Search, walks: tuple[Walk, ...], block: Array) -> float:
    """Nats by which it leads every walk without it, whatever the walk beside it."""
    bank, terms = found.bank.plus(block), found.terms
    at = np.arange(bank.columns.shape[1] - block.shape[1], bank.columns.shape[1])
    one = through(bank, walks, np.concatenate([terms.columns, at, [bank.data]]))
    p, keep = terms.columns.size, np.ones(1, dtype=bool)
    without = Terms(np.arange(p), terms.precision, terms.base)
    each = (levels(one, without.plus(p + np.arange(at.size), size), keep) for size in SIZES)
    most = max(level.nats for every in each for level in every)
    return most - max(level.nats for level in levels(one, without, keep))
