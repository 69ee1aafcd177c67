"""The covariance that positions are stated with, and the fit of every sample behind it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.setup import Setup, every_sample, motion_at
from imucalib.calibrators.array.loop.state import (
    ArrayState,
    corrected,
    followed,
    sampled_at,
    settled,
)
from imucalib.calibrators.array.loop.terms import lagging
from imucalib.calibrators.array.moving import Moving
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import Columns, gram, scores
from imucalib.estimators.array.noise import SensorNoise
from imucalib.estimators.array.samples import Readings, Sampled, Weights, fit_samples, reweighed

#: What is left where they are not, with what the parts differ by.
#: Parts of a drive other than time, and samples of a part at least.
_PARTS, _FEWEST = 4, 40
POSITIONS = "positions against "


#: Family-wise chance over all coordinates and drives below which positions are not the same.
_ALPHA = 1e-3


@dataclass(frozen=True)
class Uneven:
    """driver : what the parts differ by; p : family-wise; nats : of the coordinate that shows it
    most; spread : (d,) m, sd of each coordinate over the parts, beyond chance"""

    driver: str
    p: float
    nats: float
    spread: Array


def uneven(state: ArrayState, pulls: Array, dispersion: float) -> Uneven | None:
    """By the drive that shows it most; None where chance does as well.

    pulls : (inner, d) m, what each sample moves the positions by; dispersion : how many times fewer
    samples noise that neighbours share leaves
    """
    found = [_by(driver, part, pulls, dispersion) for driver, part in _drives(state)]
    p = min(one.p for one in found) * len(found)
    if p > _ALPHA:
        return None
    worst = min(found, key=lambda one: one.p)
    spread = np.max([one.spread for one in found if one.p * len(found) <= _ALPHA], axis=0)
    return Uneven(worst.driver, p, worst.nats, spread)


def _drives(state: ArrayState) -> Iterator[tuple[str, Index]]:
    """What could change positions, with the part (inner,) that each sample belongs to."""
    inner, sampled = state.setup.inner, state.sampled
    yield "time", state.setup.block
    for name, vector in (("|ω|", sampled.rate), ("|a|", sampled.origin)):
        size = np.linalg.norm(vector[inner], axis=1)
        ends = np.quantile(size, np.arange(1, _PARTS) / _PARTS)
        yield name, np.searchsorted(ends, size).astype(np.intp)


def _by(driver: str, part: Index, pulls: Array, dispersion: float) -> Uneven:
    """Sums of the pulls over parts, of variance Σ u² under chance: χ² of each coordinate, and what
    the parts' own places scatter by beyond it."""
    from scipy.special import gammaincc

    square, beyond, freedom = np.zeros(pulls.shape[1]), np.zeros(pulls.shape[1]), -1
    for one in np.unique(part):
        own = pulls[part == one]
        if len(own) < _FEWEST:
            continue
        total, share = own.sum(axis=0), len(own) / len(pulls)
        chance = dispersion * np.sum(own**2, axis=0)
        square += total**2 / chance
        beyond += (total**2 - chance) / share  # share of (total / share)²
        freedom += 1
    if freedom < 1:
        return Uneven(driver, 1.0, 0.0, 0.0 * beyond)
    most = float(square.max())
    p = min(1.0, float(gammaincc(0.5 * freedom, 0.5 * most)) * len(square))
    return Uneven(driver, p, 0.5 * (most - freedom), np.sqrt(np.maximum(beyond, 0.0)))


_SAMPLES = 800  # at which the answer is measured


_ROUNDS = 12  # of weights and motion after a shift


_SHIFT = 3.0  # in standard deviations of each direction


_LEAST = 0.1  # share that is left in any case


_SEEN = 1e-3  # of the best known direction's information, below which one is not shifted


def information(state: ArrayState) -> tuple[float, float]:
    """What accelerometers and gyros tell over what their weights say, by the answer of the scores
    of positions and of gyro offsets to a shift of these: 1 where the noise is Gaussian."""
    if not any(np.isfinite(noise.freedom) for noise in state.noise):
        return 1.0, 1.0
    inner = state.setup.inner
    rows = inner[np.linspace(0, len(inner) - 1, min(_SAMPLES, len(inner))).astype(np.intp)]
    readings = corrected(state).take(rows)
    start = fit_samples(
        readings, _weights(state.noise, state.sampled, rows), state.r, state.sampled.rate[rows]
    )
    answers = _Answers(readings, start, state.noise, state.r)
    return answers.of_positions(), answers.of_offsets()


class _Answers:
    """Scores at a few samples, their weights and motion fitted anew after every shift."""

    def __init__(
        self, readings: Readings, start: Sampled, noise: tuple[SensorNoise, SensorNoise], r: Array
    ) -> None:
        self.readings, self.noise, self.r = readings, noise, r
        self.start = self._followed(readings, start, r)

    def of_positions(self) -> float:
        def score(shift: Array) -> Array:
            r = self.r.copy()
            r[1:] += shift.reshape(-1, 3)
            found = self._followed(self.readings, self.start, r)
            heavy = found.off.acceleration * found.weights.acceleration[..., None]
            return np.asarray(np.einsum("tij,tki->kj", found.turn, heavy)[1:].ravel())

        count = 3 * len(self.r)
        return self._share(score, np.arange(3, count))

    def of_offsets(self) -> float:
        def score(shift: Array) -> Array:
            rate = self.readings.rate - shift.reshape(-1, 3)
            found = self._followed(replace(self.readings, rate=rate), self.start, self.r)
            return np.asarray(np.einsum("tki,tk->ki", found.off.rate, found.weights.rate).ravel())

        count = 3 * len(self.r)
        return self._share(score, np.arange(count, 2 * count))

    @cached_property
    def told(self) -> Array:
        """(6 K, 6 K) what the weights say of all positions and gyro offsets."""
        shape = (len(self.r), len(self.start.rate), 3, 3)
        bases = (np.asarray(np.broadcast_to(x, shape)) for x in (self.start.turn, np.eye(3)))
        blocks = [
            Columns(basis, gyro, False) for gyro, basis in zip((False, True), bases, strict=True)
        ]
        return gram(self.start, blocks, np.arange(shape[1])).matrix

    def _share(self, score: Callable[[Array], Array], at: Index) -> float:
        """Mean share, over directions that weigh alike, by one shift of all of them and back."""
        told = self.told[np.ix_(at, at)]
        values, vectors = eigen(told)
        seen = values > _SEEN * float(values[-1])
        signs = np.where(np.arange(int(seen.sum())) % 2, -1.0, 1.0)
        shift = _SHIFT * (vectors[:, seen] / np.sqrt(values[seen])) @ signs
        answer = 0.5 * (score(-shift) - score(shift))
        return float(np.clip(shift @ answer / (shift @ told @ shift), _LEAST, 1.0))

    def _followed(self, readings: Readings, sampled: Sampled, r: Array) -> Sampled:
        for _ in range(_ROUNDS):
            sampled = fit_samples(readings, _weights(self.noise, sampled), r, sampled)
        return sampled


def _weights(
    noise: tuple[SensorNoise, SensorNoise], sampled: Sampled, rows: Index | slice = slice(None)
) -> Weights:
    speed = np.linalg.norm(sampled.rate[rows], axis=1)
    a, g = (
        one.weight(np.sum(off[rows] ** 2, axis=2), speed)
        for one, off in zip(noise, (sampled.off.acceleration, sampled.off.rate), strict=True)
    )
    return Weights(a, g)


def stated_covariance(state: ArrayState) -> Array:
    """(q, q) of the positions (m) and of the terms' coordinates: A⁻¹ B A⁻¹."""
    return _sandwich(state)[0]


def _sandwich(state: ArrayState) -> tuple[Array, Array]:
    """That covariance, and what each sample (inner,) pulls the positions by (m).

    A is what the weights say times how far the scores answer to it (`information`), with the prior
    P; B = Σ g gᵀ + P, g the score of one sample, is what the scores really scatter (Huber 1967,
    White 1982). As many parameters as there are count as samples
    of which B is what A says, so that few samples do not make it singular.
    """
    a, g = information(state)
    base, inner = state.base, state.setup.inner
    told = base.free(gram(reweighed(state.sampled, a, g), base.blocks, inner)).matrix
    prior = np.diag(base.prior)
    own = base.along(scores(state.sampled, base.blocks, inner))
    share = len(inner) / (len(inner) + len(base.prior))
    scatter = share * (own.T @ own) + (1.0 - share) * told + prior
    bread = np.linalg.inv(told + prior)
    found = bread @ scatter @ bread
    return 0.5 * (found + found.T), own @ bread[:, : state.positions]


def with_uneven(state: ArrayState, factor: float) -> tuple[ArrayState, Uneven | None]:
    """The state with that covariance, positions known no better than parts of the motion agree on
    them, and where they do not; factor : how many times fewer samples noise that neighbours share
    leaves."""
    covariance, pulls = _sandwich(state)
    covariance *= factor
    found = uneven(state, pulls, factor)
    if found is not None:
        at = np.arange(state.positions)
        covariance[at, at] += found.spread**2
    return replace(state, covariance=covariance), found


#: Readings of one kind, samples times IMUs, that a fit takes where nobody says how many: beyond
#: them memory and time grow, and positions are known far better than they repeat.
READINGS = 60_000


_FOLLOWED = 1  # round of the motion at new samples, so that a fit there begins with its noise


def samples_taken(moving: Moving, asked: int | None) -> int:
    """How many informative samples a fit takes: all, up to what was asked or to `READINGS`."""
    return min(len(moving.good), asked or max(READINGS // moving.gyros.triads, 1))


def on_all(state: ArrayState, most: int) -> ArrayState:
    """The state at `most` of all informative samples, not settled there. Samples without
    neighbours serve unless a term needs the force's derivative."""
    neighbours = any("jerk" in term.effect.needs for term in state.terms)
    return transferred(state, every_sample(state.setup, most, neighbours=neighbours))


def fitted_on_all(state: ArrayState, most: int) -> ArrayState:
    """The joint fit at `most` of all informative samples, with the noise in the shape it has."""
    return settled_there(on_all(state, most))


def settled_there(state: ArrayState) -> ArrayState:
    """The joint fit at samples that the state was moved to, with the noise in the shape it has."""
    return settled(followed(state, _FOLLOWED), shaped=False)


def transferred(state: ArrayState, setup: Setup) -> ArrayState:
    """What was found, at other samples; to be settled there."""
    sampled = sampled_at(setup, state.r, state.noise)
    motion = motion_at(setup, sampled, None, courses=bool(lagging(state.terms)))
    return replace(state, setup=setup, sampled=sampled, motion=motion)
