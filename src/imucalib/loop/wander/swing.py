"""Swings with a period that no effect names, of the bias or of the scale.

A swing of some hours is to the noise a bias that wanders: the walk takes it over, and nothing is
missing. But a walk has no period; what has one is structure:

    lead = max over walks of L(with its cosine and sine) - max over walks, slower ones too, of L

No data need be drawn. The odds of one period, size and walk have mean one where there is no swing,
so that the chance of any lead is at most exp(-lead) times their number (Markov's inequality).
"""

from __future__ import annotations

from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.found import Unexplained
from imucalib.loop.wander.bank import Bank
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.likelihood import Terms, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.scores import SIZES, beside
from imucalib.loop.wander.slow import slower, through
from imucalib.loop.wander.walk import Walk

#: Swings in a recording: three at least, else it is anything that passes; at most sixty, about as
#: quick as the shortest walk, and one in five runs; steps between which a wave keeps nine tenths.
_FEWEST, _MOST, _RUNS, _STEP = 3.0, 60.0, 5.0, 0.5
#: What may swing: parts of the base model.
_SWINGS = ("bias", "scale")
#: Chance up to which a swing is told, as in `scores.sure`: no noise is just a walk of those tried.
_CHANCE = 1e-3


def swings(problem: Problem, found: Search) -> tuple[Unexplained, ...]:
    """The likeliest swing beside all that was taken, where its chance is a thousandth at most."""
    bank, time = found.bank, found.bank.course.time
    walks = (*bank.walks, *slower(bank))
    ways = list(product(_blocks(problem, bank), _counts(time)))
    if not ways:
        return ()
    blocks = [_waves(columns, time, count) for (_, columns), count in ways]
    bar = float(np.log(len(ways) * len(SIZES) * len(walks) / _CHANCE))
    first = _beside_own(found, blocks)
    best = int(np.argmax(first))
    if first[best] < bar:
        return ()
    nats = _lead(found, walks, blocks[best])
    if nats < bar:
        return ()
    (name, _), count = ways[best]
    words = f"the {name} swings with a period of {np.ptp(time) / count / 3600.0:.2g} h"
    chance = _CHANCE * float(np.exp(bar - nats))
    share = 1.0 - float(np.exp(-2.0 * nats / time.size))
    return (Unexplained(words, "time", "swing", chance, nats, share),)


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


def _counts(time: Array) -> Array:
    """(k,) swings in the recording."""
    return np.arange(_FEWEST, min(_MOST, time.size / _RUNS), _STEP)


def _blocks(problem: Problem, bank: Bank) -> list[tuple[str, Array]]:
    """What may swing, with its columns (n, c) in units of a run's scatter, one in the mean."""
    slices = problem.fit.model.slices(problem.fit.observations.context)
    every = [(name, bank.columns[:, slices[name]]) for name in _SWINGS if name in slices]
    # An axis that no posture shows has a column of nothing, and keeps it.
    return [(name, own / np.sqrt(np.mean(own**2, axis=0) + 1e-300)) for name, own in every]


def _waves(columns: Array, time: Array, count: float) -> Array:
    angle = 2.0 * np.pi * count * ((time - time[0]) / np.ptp(time))[:, None]
    return np.column_stack([columns * np.cos(angle), columns * np.sin(angle)])
