"""Preconditioned Crank-Nicolson: chains of a density that is nearly a unit Gaussian.

A proposal √(1 - β²) z + β ξ leaves the unit Gaussian as it is, so that it is taken or refused by
how far the density departs from that alone; with β = 1 it is independent Metropolis (Cotter,
Roberts, Stuart, White: MCMC methods for functions, Statistical Science 28 (2013), section 4). Where
nearly all are taken, the Gaussian is the density's shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import NotConverged
from imucalib.estimators.markov.convergence import Convergence, convergence

#: (chains, d) in the frame -> log density (chains,), up to a constant
Target = Callable[[Array], Array]
#: Shares β of a proposal that is new, tried in this order, and the acceptance from which one
#: serves: half as many taken cost three times the draws, a β of 0.7 costs as many.
_STEPS, _TAKEN = (1.0, 0.7, 0.5, 0.35, 0.25, 0.15), 0.5


@dataclass(frozen=True)
class Stop:
    """When chains are long enough: blocks of `block` draws until R-hat is met and ESS in the bulk,
    which is what a mean needs. R-hat below 1.01 takes many more draws of nearly independent ones
    than ESS does, which counts what lies between chains too."""

    rhat: float = 1.05
    ess: float = 400.0
    block: int = 40
    most: int = 4000


@dataclass(frozen=True)
class Chains:
    """draws : (chains, n, d) in the frame; accepted : mean acceptance; step : β; convergence : of
    what was seen"""

    draws: Array
    accepted: float
    step: float
    convergence: Convergence


def sample(
    target: Target,
    d: int,
    rng: np.random.Generator,
    *,
    pairs: int = 2,
    stop: Stop | None = None,
    seen: Callable[[Array], Array] = lambda draws: draws,
) -> Chains:
    """Draw until the diagnostics of `seen(draws)`, what will be reported, are met.

    The chains of a pair take opposite proposals, so that the error of one's mean is nearly the
    other's with its sign changed.

    Raises NotConverged with the diagnostics when `stop.most` draws are not enough.
    """
    rule, steps, taken = stop or Stop(), list(_STEPS), 0.0
    z = _opposite(rng, pairs, d)
    level, draws = target(z), np.empty((2 * pairs, 0, d))
    while True:
        z, level, more, share = _block(target, z, level, steps[0], rule.block, rng)
        if share < _TAKEN and len(steps) > 1 and not draws.size:
            del steps[0]
            continue
        draws, taken = np.concatenate([draws, more], axis=1), taken + share * rule.block
        count = draws.shape[1]
        if count < 2 * rule.block:
            continue
        found = convergence(seen(draws))
        if found.is_reached(rule.rhat, rule.ess, tails=False):
            return Chains(draws, taken / count, steps[0], found)
        if count >= rule.most:
            raise NotConverged(
                f"the chains do not agree after {count} draws each: {found.sentence}",
                remedy="too little rotation, or samples that contradict each other: record a "
                "more varied motion, or use more samples",
            )


def _opposite(rng: np.random.Generator, pairs: int, d: int) -> Array:
    """(2 pairs, d) normal numbers, the second half the first's with their signs changed."""
    one = rng.standard_normal((pairs, d))
    return np.concatenate([one, -one])


def _block(
    target: Target, z: Array, level: Array, step: float, count: int, rng: np.random.Generator
) -> tuple[Array, Array, Array, float]:
    """The chains `count` draws on, their levels, those draws, and the share that was taken."""
    chains, d = z.shape
    draws, taken = np.empty((chains, count, d)), 0.0
    white = np.array([_opposite(rng, chains // 2, d) for _ in range(count)])
    # Proposals that hang on no draw are judged all at once.
    ahead = target(white.reshape(-1, d)).reshape(count, chains) if step == 1.0 else None
    for k in range(count):
        there = np.sqrt(1.0 - step**2) * z + step * white[k]
        high = target(there) if ahead is None else ahead[k]
        # What remains of the density when the Gaussian is divided out.
        gain = high - level + 0.5 * np.sum(there**2 - z**2, axis=1)
        moved = np.log(np.tile(rng.random(chains // 2), 2)) < gain
        z, level = np.where(moved[:, None], there, z), np.where(moved, high, level)
        draws[:, k] = z
        taken += float(moved.mean()) / count
    return z, level, draws, taken
