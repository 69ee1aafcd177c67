"""The gyros' own clocks in the loop: their beats from samples that do not vote on them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.loop.motion import board_motion
from imucalib.calibrators.array.loop.setup import Setup, with_neighbours
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.moving import Moving
from imucalib.core.effect import Context, Response, Truth
from imucalib.estimators.array.sample_age import SampleAge, fit_sample_age
from imucalib.estimators.array.samples import Readings, Sampled, Weights, fit_samples

_GROUP = 8  # samples that learn or vote together where all are in the search
_READINGS = 20_000  # samples times IMUs that are worked on at a time
_TRAIN = 0.5  # share of the informative samples outside of the search from which they suffice


#: Turns by which the phase of a gyro's clock is known: blocks of a few seconds vote for it among
#: steps of an eightieth (`estimators/array/sample_age`).
PHASE = 0.01


@dataclass(frozen=True)
class Ages:
    """wave : (T, K) unit sawtooths at the search's samples; voting : (T,) samples from which they
    were not learned; clock : frequencies and lines"""

    wave: Array
    voting: Flags
    clock: SampleAge


@dataclass(frozen=True)
class Beat:
    """Steady part of a sawtooth: φ(t) = frequency (t - at) + phase, in turns; Hz, negative when the
    age falls with time; wander : rms turns by which the phase leaves that line"""

    frequency: float
    phase: float
    at: float
    wander: float


def beats(ages: Ages, t: Array) -> tuple[Beat | None, ...]:
    """The beat of each gyro at the times (T,) s of its sawtooth; None without one."""
    at = float(t[0])
    found: list[Beat | None] = []
    for f, wave in zip(ages.clock.frequency, ages.wave.T, strict=True):
        if not np.isfinite(f):
            found.append(None)
            continue
        off = np.unwrap(2.0 * np.pi * (wave + 0.5 - f * (t - at))) / (2.0 * np.pi)
        slope, start = np.polyfit(t - at, off, 1)
        wander = float(np.sqrt(np.mean((off - start - slope * (t - at)) ** 2)))
        found.append(Beat(float(f + slope), float(start % 1.0), at, wander))
    return tuple(found)


def found_ages(state: ArrayState, moving: Moving, *, all_rows: bool = False) -> Ages | None:
    """Sawtooth ages from the samples outside of the search; None where no gyro shows a line."""
    setup = state.setup
    near, learning, voting = _learning(setup, moving)
    if all_rows:
        learning, voting = near, np.ones(len(moving.t), dtype=np.bool_)
    if len(learning) < 100:
        return None
    off, spin = _everywhere(state, moving, near)
    clock = fit_sample_age(moving.t, off, spin, learning)
    if not np.isfinite(clock.frequency).any():
        return None
    return Ages(clock.wave[setup.rows], voting[setup.rows], clock)


def _learning(setup: Setup, moving: Moving) -> tuple[Index, Index, Flags]:
    """Samples with neighbours, those of them that learn, and (N,) those that vote."""
    near = with_neighbours(moving)
    looked = np.zeros(len(moving.t), dtype=np.bool_)
    looked[setup.apart] = True
    learning = near[~looked[near]]
    if len(learning) >= _TRAIN * len(near):
        return near, learning, np.ones(len(moving.t), dtype=np.bool_)
    turn = (np.arange(len(moving.t)) // _GROUP) % 2 == 0
    return near, near[turn[near]], ~turn


def voting(setup: Setup, moving: Moving) -> Flags:
    """(inner,) samples of which no clock is ever learned."""
    return np.asarray(_learning(setup, moving)[2][setup.rows[setup.inner]])


def ages_elsewhere(ages: Ages, setup: Setup, moving: Moving) -> Ages:
    """The same clocks at other samples."""
    told = _learning(setup, moving)[2]
    return Ages(ages.clock.wave[setup.rows], told[setup.rows], ages.clock)


def kept_ages(state: ArrayState, ages: Ages, *, voting: bool) -> ArrayState:
    """The state with the ages; while voting, samples that they were learned from are silent."""
    wave = np.where(ages.voting[:, None], ages.wave, 0.0) if voting else ages.wave
    return replace(state, motion=state.motion.aged(wave))


def with_phases(state: ArrayState) -> ArrayState:
    """With what is not known of the clocks' phases where the model has their ages, and without it
    where it has not."""
    rest = tuple(term for term in state.terms if term.found or not term.aged)
    clock = next((term.effect for term in rest if term.aged), None)
    if clock is None:
        return replace(state, terms=rest)
    if len(rest) < len(state.terms):
        return state
    effect = phases_of(clock)
    n = state.setup.triads * len(effect.each)
    term = Term(effect.name, effect, None, PHASE * np.eye(n), np.zeros(n), np.ones(n), found=False)
    return replace(state, terms=(*rest, term))


def phases_of(clock: Response) -> Response:
    """What phases that are not quite known leave of clocks: of each gyro an age that is steady, or
    follows a straight line or a bent one over the motion."""

    def basis(truth: Truth, context: Context) -> Array:
        known = {**context.covariates, "sample_age": np.ones(truth.shape[:2])}
        steady = clock.basis(truth, replace(context, covariates=known))
        course = 2.0 * context["order"] - 1.0
        courses = np.stack([np.ones(len(course)), course, 1.5 * course**2 - 0.5], axis=1)
        return np.asarray(steady * courses[:, None, None, :])

    each = tuple(replace(clock.each[0], name=f"phase_{k}") for k in range(3))
    return replace(clock, name="phases", each=each, shared=False, basis=basis)


def _everywhere(state: ArrayState, moving: Moving, rows: NDArray[np.intp]) -> tuple[Array, Array]:
    """(N, K, 3) gyro residuals and (N, 3) dω/dt at all informative samples, the clocks not yet
    taken out; zero elsewhere."""
    n, k = len(moving.t), state.setup.triads
    off, spin = np.zeros((n, k, 3)), np.zeros((n, 3))
    some = max(_READINGS // k, 1)
    for a in range(0, len(rows), some):  # of many IMUs the columns of all samples would be large
        part = rows[a : a + some]
        sampled = _fitted_at(state, moving, part)
        off[part] = sampled.off.rate - sampled.off.rate.mean(axis=1, keepdims=True)
        spin[part] = sampled.spin
    return off, spin


def _fitted_at(state: ArrayState, moving: Moving, rows: NDArray[np.intp]) -> Sampled:
    """The motion of other samples under what was found."""
    t, span = moving.t[rows], float(max(np.ptp(state.setup.t), 1e-9))
    readings = Readings(moving.acceleration[rows], moving.rate[rows])
    ones = np.ones((len(rows), state.setup.triads))
    weights = Weights(ones / state.noise[0].sigma ** 2, ones / state.noise[1].sigma ** 2)
    order = (t - state.setup.t[0]) / span
    sampled = fit_samples(readings, weights, state.r, np.median(readings.rate, axis=1))
    plain = [term for term in state.terms if not term.aged]
    for _ in range(2 if plain else 0):
        motion = board_motion(
            imus=state.setup.imus,
            rotations=state.setup.board.rotations,
            t=t,
            order=order,
            rate=sampled.rate,
            spin=sampled.spin,
            force=sampled.force,
            jerk=np.zeros_like(sampled.force),
        )
        acceleration, rate = readings.acceleration.copy(), readings.rate.copy()
        for term in plain:
            columns = term.columns(motion)
            (rate if columns.gyro else acceleration)[...] -= term.reading(columns)
        sampled = fit_samples(Readings(acceleration, rate), weights, state.r, sampled.rate)
    return sampled
