"""Effects that are declared, added to a state beside the fit; and noise that neighbours share."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.ages import found_ages, kept_ages, with_phases
from imucalib.calibrators.array.loop.catalogue import named_effect
from imucalib.calibrators.array.loop.laws import typical_columns
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term, determined
from imucalib.calibrators.array.moving import Moving
from imucalib.core.effect import Response
from imucalib.errors import Undetermined
from imucalib.estimators.array.gram import gram
from imucalib.estimators.array.reduced import reduced
from imucalib.loop.found import Unexplained
from imucalib.loop.posterior.odds import COMPLETE

#: Samples over which a sum of residuals is taken, and the farthest neighbours that are asked.
_RUN, _FAR = 16, 6
#: Pairs of neighbours below which nothing is known of what they share, and standard deviations of
#: chance below which it is nothing.
_FEWEST, _CHANCE = 50, 2.0


def with_declared(state: ArrayState, names: Sequence[str], moving: Moving) -> ArrayState:
    """The joint fit with the named effects in the model.

    Raises UsageError for unknown names, Undetermined where the motion cannot carry one.
    """
    for name in names:
        effect, _ = named_effect(name, state.setup.imus)
        if "sample_age" in effect.needs and state.motion.age is None:
            ages = found_ages(state, moving)
            state = state if ages is None else kept_ages(state, ages, voting=True)
        reason = effect.missing(state.motion.context)
        term = None if reason else declared_term(state, name)
        if term is None or len(term.value) == 0:
            raise Undetermined(
                f"{name} was declared, and this motion does not show it"
                + (f": {reason}" if reason else ""),
                remedy=effect.identify,
            )
        state = replace(state, terms=(*state.terms, term))
    return settled(with_phases(state)) if names else state


def declared_term(state: ArrayState, name: str) -> Term:
    """An effect as a new term of a fitted state: what these data can determine of it, at zero."""
    effect, only = named_effect(name, state.setup.imus)
    matrix = beside_the_fit(state, effect, only)
    return determined(name, effect, only, matrix, state.found)


def beside_the_fit(state: ArrayState, effect: Response, only: int | None = None) -> Array:
    """(p, p) Gram matrix, in units of the noise, of an effect's columns in typical sizes, with
    motion, positions and terms taken out."""
    columns = typical_columns(effect, state.motion, only)
    found = state.base.free(gram(state.sampled, [*state.base.blocks, columns], state.setup.inner))
    rests = state.base.rests
    return reduced(found, rests, 0.0 * rests).matrix


def _shared(state: ArrayState, *, gyro: bool) -> Iterator[tuple[float, float]]:
    """Correlation of the weighted residuals of samples 1, 2, ... apart, and how many independent
    products it is the mean of; until there are few."""
    setup, off = state.setup, state.sampled.off
    values = off.rate if gyro else off.acceleration
    weight = state.sampled.weights.rate if gyro else state.sampled.weights.acceleration
    white = (values * np.sqrt(weight)[..., None])[setup.inner]
    beside = np.diff(setup.rows[setup.inner]) == 1
    power = float(np.mean(white**2))
    # The motion takes its share of the numbers out of every sample.
    numbers = max(3 * white.shape[1] - (3 if gyro else 6), 1)
    for k in range(1, _FAR + 1):
        together = np.convolve(beside, np.ones(k), "valid") == k
        if together.sum() < _FEWEST or power == 0.0:
            return
        product = float(np.mean((white[:-k] * white[k:])[together]))
        yield product / power, float(together.sum() * numbers)


def shared_by_neighbours(state: ArrayState, *, gyro: bool) -> float:
    """How many times fewer samples noise with memory is worth: the variance of a sum over a run
    of samples over that of independent ones, 1 + 2 Σ ρ_k (1 - k / run), up to the first neighbour
    that shares nothing beyond chance."""
    factor = 1.0
    for k, (rho, n) in enumerate(_shared(state, gyro=gyro), 1):
        if rho * np.sqrt(n) < _CHANCE:
            break
        factor += 2.0 * rho * (1.0 - k / _RUN)
    return factor


def remembered(state: ArrayState) -> Iterator[Unexplained]:
    """Sensors whose noise follows its own past, where noise without memory is unlikely at even odds
    (Schwarz 1978): something goes on from sample to sample that the model does not have."""
    for sensor, gyro in (("accelerometer", False), ("gyroscope", True)):
        rho, n = next(_shared(state, gyro=gyro), (0.0, 1.0))
        nats = 0.5 * n * max(rho, 0.0) ** 2 - 0.5 * float(np.log(n))
        p = 1.0 / (1.0 + float(np.exp(min(nats, 700.0))))
        if p < COMPLETE:
            name = f"{sensor} noise correlated in time"
            yield Unexplained(name, "time", "noise", 1.0 - p, nats)
