"""The gyros' own clocks in the loop: their beats from samples that do not vote on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.motion.setup import Setup
from imucalib.calibrators.array.motion.state import ArrayState, fit_motion_at, subtract_terms
from imucalib.calibrators.array.motion.terms import Term, board_motion
from imucalib.core.effect import Context, Response, Truth
from imucalib.estimators.array.sample_age import SampleAge, fit_sample_age
from imucalib.estimators.array.samples import Sampled, fit_samples

_GROUP = 8  # samples that learn or vote together where all are in the search
_READINGS = 20_000  # samples times IMUs that are worked on at a time
_TRAIN = 0.5  # share of the informative samples outside of the search from which they suffice
_FEWEST = 100  # samples from which a clock is learned

#: Turns by which the phase of a gyro's clock is known: blocks of a few seconds vote for it among
#: steps of an eightieth (`estimators/array/sample_age`).
PHASE = 0.01


@dataclass(frozen=True)
class Beat:
    """Steady part of a sawtooth: φ(t) = hz (t - at_s) + phase_turns, in turns; Hz, negative when
    the age falls with time; wander_turns : rms by which the phase leaves that line"""

    hz: float
    phase_turns: float
    at_s: float
    wander_turns: float


def beats(clock: SampleAge, t: Array, rows: Index) -> Iterator[Beat | None]:
    """The beat of each gyro over rows of the clock's samples, at times t (T,) s; None without
    one."""
    at = float(t[0])
    for f, wave in zip(clock.frequency, clock.wave[rows].T, strict=True):
        if not np.isfinite(f):
            yield None
            continue
        off = np.unwrap(2.0 * np.pi * (wave + 0.5 - f * (t - at))) / (2.0 * np.pi)
        slope, start = np.polyfit(t - at, off, 1)
        scatter = float(np.sqrt(np.mean((off - start - slope * (t - at)) ** 2)))
        yield Beat(float(f + slope), float(start % 1.0), at, scatter)


def estimate_clock(state: ArrayState, *, every: bool = False) -> SampleAge | None:
    """Sawtooth ages from the samples outside of the search, or from every one; None where no gyro
    shows a line."""
    amid = state.setup.moving.amid
    learning = amid if every else _select_learning(state.setup)[0]
    if len(learning) < _FEWEST:
        return None
    off, spin = _everywhere(state, amid)
    clock = fit_sample_age(state.setup.moving.t, off, spin, learning)
    return clock if np.isfinite(clock.frequency).any() else None


def _select_learning(setup: Setup) -> tuple[Index, Flags]:
    """Samples from which clocks are learned, and (T,) those of the setup that vote on them."""
    amid = setup.moving.amid
    learning = amid[~np.isin(amid, setup.chosen)]
    if len(learning) >= _TRAIN * len(amid):
        return learning, np.ones(len(setup.rows), dtype=np.bool_)
    return amid[(amid // _GROUP) % 2 == 0], (setup.rows // _GROUP) % 2 != 0


def find_voting(setup: Setup) -> Flags:
    """(inner,) samples of which no clock is ever learned."""
    return np.asarray(_select_learning(setup)[1][setup.inner])


def add_clock(state: ArrayState, clock: SampleAge, *, voting: bool) -> ArrayState:
    """The state with the ages of a clock; while voting, samples that it was learned from are
    silent."""
    wave = clock.wave[state.setup.rows]
    if voting:
        wave = np.where(_select_learning(state.setup)[1][:, None], wave, 0.0)
    return replace(state, clock=clock, motion=state.motion.set_ages(wave))


def add_estimated_clock(state: ArrayState) -> ArrayState:
    """With the clocks that it shows, or as it was."""
    clock = estimate_clock(state)
    return state if clock is None else add_clock(state, clock, voting=True)


def add_phases(state: ArrayState) -> ArrayState:
    """With what is not known of the clocks' phases where the model has their ages, and without it
    where it has not."""
    rest = tuple(term for term in state.terms if term.found or not term.aged)
    clock = next((term.effect for term in rest if term.aged), None)
    if clock is None:
        return replace(state, terms=rest)
    if len(rest) < len(state.terms):
        return state
    effect = phases_of(clock)
    n = state.setup.board.count * len(effect.each)
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


def _everywhere(state: ArrayState, rows: Index) -> tuple[Array, Array]:
    """(N, K, 3) gyro residuals and (N, 3) dω/dt at some samples, with the clocks still in them, and
    zero elsewhere."""
    n, k = len(state.setup.moving.t), state.setup.board.count
    off, spin = np.zeros((n, k, 3)), np.zeros((n, 3))
    some = max(_READINGS // k, 1)
    for a in range(0, len(rows), some):  # of many IMUs the columns of all samples would be large
        part = rows[a : a + some]
        sampled = _fit_at(state, part)
        off[part] = sampled.off.rate - sampled.off.rate.mean(axis=1, keepdims=True)
        spin[part] = sampled.spin
    return off, spin


def _fit_at(state: ArrayState, rows: Index) -> Sampled:
    """The motion of other samples under what was found."""
    setup, plain = replace(state.setup, rows=rows), tuple(t for t in state.terms if not t.aged)
    sampled = fit_motion_at(setup, state.r, state.noise)
    for _ in range(2 if plain else 0):
        one, order = sampled, setup.order
        motion = board_motion(
            setup.board, setup.t, order=order, rate=one.rate, spin=one.spin, force=one.force
        )
        rest = subtract_terms(replace(state, setup=setup, terms=plain, motion=motion))
        sampled = fit_samples(rest, sampled.weights, state.r, sampled.rate)
    return sampled
