"""Data that lack nothing, and what no candidate reaches on them."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.wander.bank import Bank
from imucalib.loop.wander.likelihood import Level, Terms, levels
from imucalib.loop.wander.noise import likely_walks, usable_walks
from imucalib.loop.wander.projected import Null
from imucalib.loop.wander.scores import SIZES, Entry, scored
from imucalib.loop.wander.walk import drawn, whitened


def by_chance(
    bank: Bank, terms: Terms, entries: Sequence[Entry], rng: np.random.Generator, draws: int
) -> Array:
    """(2, draws) nats of the best candidate, as `scored` tells it, on data that lack nothing."""
    keep = np.ones(bank.course.parts, dtype=bool)
    every = levels(bank, terms, keep)
    null = null_of(bank, every, rng, draws, likely_walks(every))
    walks = usable_walks(bank, max(every, key=lambda one: one.nats), same_tau=False)
    return scored(bank, terms, keep, entries, walks, null, told=False)[1]


def null_of(
    bank: Bank, every: Sequence[Level], rng: np.random.Generator, draws: int, walks: Collection[int]
) -> Null:
    """Drawn from every walk as often as its likelihood says: the noise is not known exactly.

    walks : under which the data are to be scored
    """
    nats = np.array([level.nats for level in every])
    weight = np.exp(nats - nats.max())
    often = [int(count) for count in rng.multinomial(draws, weight / weight.sum())]
    data = np.concatenate(
        [
            np.sqrt(level.variance) * drawn(bank.course, bank.walks[level.walk], rng, count)
            for level, count in zip(every, often, strict=True)
            if count
        ],
        axis=1,
    )
    # Single precision is a thousandth of a nat here, at half the time.
    columns, both = bank.columns.shape[1], np.column_stack([bank.columns, data]).astype(np.float32)
    null = Null({}, {}, draws)
    for walk in walks:
        white = whitened(bank.course, bank.walks, both, slice(walk, walk + 1))[0][0]
        own, one = white[:, :columns], white[:, columns:]
        null.along[walk] = own.T @ one
        null.power[walk] = np.einsum("nd,nd->d", one, one, dtype=np.float64)
    return null


def sure(draws: int, ways: int) -> float:
    """Nats that nothing but time reaches where nothing is missing, so that no data need be drawn:
    the odds of a size have mean one then, whatever the noise (Markov's inequality).

    ways : candidates and walks, multiplied
    """
    return float(np.log(1e3 * draws * len(SIZES) * max(ways, 1)))
