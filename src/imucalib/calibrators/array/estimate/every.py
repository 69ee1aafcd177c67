"""A fit that was found on some samples, on all that say something."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.calibrators.array.loop.setup import Setup, every_sample, motion_at
from imucalib.calibrators.array.loop.state import ArrayState, followed, settled
from imucalib.calibrators.array.loop.terms import lagging
from imucalib.calibrators.array.moving import Moving
from imucalib.estimators.array.samples import Weights, fit_samples

#: Readings of one kind, samples times IMUs, that a fit takes where nobody says how many: beyond
#: them memory and time grow, and positions are known far better than they repeat.
READINGS = 60_000
_FOLLOWED = 1  # round of the motion at new samples, so that a fit there begins with its noise


def samples_taken(moving: Moving, asked: int | None) -> int:
    """How many informative samples a fit takes: all, up to what was asked or to `READINGS`."""
    return min(len(moving.good), asked or max(READINGS // moving.gyros.triads, 1))


def on_all(state: ArrayState, moving: Moving, most: int) -> ArrayState:
    """The state at `most` of all informative samples, not settled there. Samples without
    neighbours serve unless a term needs the force's derivative."""
    beside = any("jerk" in term.effect.needs for term in state.terms)
    return transferred(state, every_sample(moving, state.setup, most, beside=beside))


def fitted_on_all(state: ArrayState, moving: Moving, most: int) -> ArrayState:
    """The joint fit at `most` of all informative samples, with the noise in the shape it has."""
    return settled_there(on_all(state, moving, most))


def settled_there(state: ArrayState) -> ArrayState:
    """The joint fit at samples that the state was moved to, with the noise in the shape it has."""
    return settled(followed(state, _FOLLOWED), shaped=False)


def transferred(state: ArrayState, setup: Setup) -> ArrayState:
    """What was found, at other samples; to be settled there."""
    ones = np.ones(setup.readings.rate.shape[:2])
    weights = Weights(ones / state.noise[0].sigma ** 2, ones / state.noise[1].sigma ** 2)
    rate = np.median(setup.readings.rate, axis=1)
    sampled = fit_samples(setup.readings, weights, state.r, rate)
    motion = motion_at(setup, sampled, None, courses=bool(lagging(state.terms)))
    return replace(state, setup=setup, sampled=sampled, motion=motion)
