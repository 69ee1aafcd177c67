"""The fused motion of a stretch of samples: weights, effects beyond the linear part, clipped axes.

Each round fits the motion of every sample, takes out what the found effects add at that motion, and
weighs each triad by what it leaves. The last one also knows dω/dt from the neighbours' rates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.fused.doubt import of_the_calibration
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.neighbours import near_next, spin_by_neighbours
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.fused.start import Start, inside, outside, start_of
from imucalib.calibrators.array.fused.stretch import Stretch, along
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.core.course import slope_of
from imucalib.core.truth import Motion
from imucalib.estimators.array.fusion import FusedMotion, Sensed, fused_motion, precision_of

_SHORT = 4  # samples from which on lags are undone by the course of the motion
_GOES_ON = 0.5  # correlation of neighbours from which on a correction is motion


@dataclass(frozen=True)
class Fused:
    """motion : of every sample, its covariance that of the noise, or with the calibration's doubt
    off, rate_off : (T, K, 3) what the sensors' axes read beside it, m/s² and rad/s
    live, rate_live : (T, K, 3) axes that took part; alone : (T,) no gyro saw some part of the rate
    weights : (T, K, 3) of the axes, (m/s²)^-2 and (rad/s)^-2
    """

    motion: FusedMotion
    off: Array
    rate_off: Array
    live: Flags
    rate_live: Flags
    alone: Flags
    weights: tuple[Array, Array]

    def take(self, rows: slice | Index) -> Fused:
        one, two = self.weights
        return Fused(
            motion=self.motion.take(rows), off=self.off[rows], rate_off=self.rate_off[rows],
            live=self.live[rows], rate_live=self.rate_live[rows], alone=self.alone[rows],
            weights=(one[rows], two[rows]),
        )  # fmt: skip


@dataclass(frozen=True)
class _Task:
    """What does not change from round to round."""

    instrument: Instrument
    stretch: Stretch
    start: Start
    noise: tuple[ChipNoise, ChipNoise]
    age: Array | None
    late: Array | None
    tied: bool


@dataclass(frozen=True)
class _State:
    """Where the rounds stand: the readings less effects (T, K, 3), the gyros' live axes, shares
    (T, K, 1) of the triads' weights, the motion so far, what it was made from, what it leaves."""

    force: Array
    gyro: Array
    rate_live: Flags
    shares: tuple[Array, Array]
    motion: FusedMotion | None = None
    sensed: Sensed | None = None
    weights: tuple[Array, Array] | None = None
    off: tuple[Array, Array] | None = None


def fuse(
    instrument: Instrument,
    stretch: Stretch,
    noise: tuple[ChipNoise, ChipNoise],
    age: Array | None = None,
    *,
    rounds: int = 4,
    tied: bool = True,
    whole: bool = False,
) -> Fused:
    """Fuse the samples of a stretch.

    noise : of accelerometers and gyros
    age : (T, K) sawtooths of the gyros' clocks, NaN for a clock that was not found, or None
    tied : whether neighbours tell of dω/dt; the samples must then follow each other
    whole : whether the covariance holds what the calibration leaves open beside the noise
    """
    start = start_of(instrument, stretch)
    late = instrument.beyond.late(stretch.t, None if age is None else np.nan_to_num(age))
    task = _Task(
        instrument=instrument, stretch=stretch, start=start, noise=noise, age=age, late=late,
        tied=tied,
    )  # fmt: skip
    one = np.ones((*stretch.rate.shape[:2], 1))
    state = _State(start.force, start.gyro, start.rate_live, (one, one))
    for turn in range(rounds):
        state = _next(task, state, turn)
    motion, sensed, weights, off = state.motion, state.sensed, state.weights, state.off
    assert motion is not None
    assert sensed is not None
    assert weights is not None
    assert off is not None
    if tied and (known := spin_by_neighbours(stretch.t, motion, late)) is not None:
        sensed = replace(sensed, spin=known[0], spin_precision=known[1])
        motion = fused_motion(sensed, instrument.r, motion.rate)
    own = _widened(motion, noise)
    if whole and instrument.doubt is not None:
        seen = _seen(instrument, stretch.t, motion)
        more = of_the_calibration(instrument.doubt, motion, sensed, instrument.r, seen)
        own = replace(own, covariance=own.covariance + more)
    return Fused(
        motion=own, off=off[0], rate_off=off[1], live=start.live,
        rate_live=state.rate_live, alone=start.alone, weights=weights,
    )  # fmt: skip


def _next(task: _Task, state: _State, turn: int) -> _State:
    """One more round."""
    instrument, stretch, start = task.instrument, task.stretch, task.start
    variances = _variances(task, state.motion)
    weights = _weights(start, state, variances)
    sensed = Sensed(
        force=state.force,
        rate=state.gyro,
        force_precision=precision_of(instrument.axes, weights[0]),
        rate_precision=precision_of(instrument.gyro_axes, weights[1]),
        late=task.late,
    )
    before = start.first if state.motion is None else state.motion.rate
    motion = fused_motion(sensed, instrument.r, before)
    rate_live, back = state.rate_live, np.zeros(len(stretch.t), dtype=np.bool_)
    if turn == 0:
        motion = outside(instrument, stretch, start, sensed, motion)
    if turn == 1:  # the effects are out by then: an answer inside the range goes to its end
        rate_live = rate_live | inside(instrument, stretch, start, motion)
        back = np.any(rate_live != state.rate_live, axis=(1, 2))
        motion = replace(motion, rate=np.where(back[:, None], start.first, motion.rate))
    force, gyro = _without_effects(task, motion)
    off = _residuals(task, motion, force, gyro)
    one, two = _shares(task, rate_live, off, variances)
    two[back] = 1.0  # far from where it is pulled to, it would have no say
    return _State(
        force=force, gyro=gyro, rate_live=rate_live, shares=(one, two), motion=motion,
        sensed=sensed, weights=weights, off=off,
    )  # fmt: skip


def _variances(task: _Task, motion: FusedMotion | None) -> tuple[Array, Array]:
    """(T, K, 3) of the axes. A gyro whose clock is not known is off by its age times dω/dt, the age
    anywhere within its span."""
    rate = task.start.first if motion is None else motion.rate
    speed = np.linalg.norm(rate, axis=1)
    first, second = task.noise[0].variance(speed), task.noise[1].variance(speed)
    span = task.instrument.beyond.span
    if span > 0.0 and motion is not None:
        spin = np.broadcast_to(motion.spin[:, None], second.shape)
        unknown = np.ones(second.shape[:2]) if task.age is None else np.isnan(task.age)
        swing = along(task.instrument.gyro_axes, spin) ** 2
        second = second + span**2 / 12.0 * unknown[..., None] * swing
    return first, second


def _weights(start: Start, state: _State, variances: tuple[Array, Array]) -> tuple[Array, Array]:
    one, two = (
        np.where(live, share, 0.0) / variance
        for live, share, variance in zip(
            (start.live, state.rate_live), state.shares, variances, strict=True
        )
    )
    return one, two


def _shares(
    task: _Task, rate_live: Flags, off: tuple[Array, Array], variances: tuple[Array, Array]
) -> tuple[Array, Array]:
    """(T, K, 1) of the weights, by the length of the residuals."""
    live = (task.start.live, rate_live)
    one, two = (
        chip.share(np.sum(np.where(on, left**2 / variance, 0.0), axis=2), on.sum(axis=2))
        for chip, on, left, variance in zip(task.noise, live, off, variances, strict=True)
    )
    return one[..., None], two[..., None]


def _without_effects(task: _Task, motion: FusedMotion) -> tuple[Array, Array]:
    """Corrected readings (T, K, 3) less what the effects beyond the linear parts add."""
    start, beyond = task.start, task.instrument.beyond
    if all(part.late and not part.lags for part in beyond.parts):
        return start.force, start.gyro
    seen = _seen(task.instrument, task.stretch.t, motion)
    beside = beyond.besides_lags(seen)
    force, gyro = beyond.added(seen, beside)
    if task.tied and beyond.lags and len(task.stretch.t) > _SHORT:
        whole = beyond.added(_over_time(seen), beside)
        force, gyro = _where_smooth(force, whole[0]), _where_smooth(gyro, whole[1])
    return start.force - force, start.gyro - gyro


def _where_smooth(first: Array, whole: Array) -> Array:
    """Lags undone whole where what that adds to the first order, (T, K, 3), goes on from sample to
    sample: what does not is the noise of a second derivative."""
    more = whole - first
    power = float(np.sum(more**2))
    goes_on = power > 0.0 and float(np.sum(more[1:] * more[:-1])) > _GOES_ON * power
    return whole if goes_on else first


def _seen(instrument: Instrument, t: Array, motion: FusedMotion) -> BoardMotion:
    """The motion as effects take it."""
    felt = motion.felt(instrument.r)
    jerk = np.zeros_like(felt)
    if instrument.beyond.needs_jerk and len(t) > 2:
        usual = near_next(t)
        slope = (felt[2:] - felt[:-2]) / (t[2:] - t[:-2])[:, None, None]
        jerk[1:-1] = np.where((usual[1:] & usual[:-1])[:, None, None], slope, 0.0)
    return board_motion(
        imus=instrument.imus, rotations=instrument.beyond.rotations, t=t,
        order=np.full(len(t), 0.5), rate=motion.rate, spin=motion.spin, force=felt, jerk=jerk,
    )  # fmt: skip


def _over_time(seen: BoardMotion) -> BoardMotion:
    """The motion with its courses, of which lagging sensors meet a part."""
    t, turning = seen.context["time"], seen.truth.turning
    near = near_next(t)
    beside = np.stack([np.append(False, near), np.append(near, False)], axis=1)
    jerk = slope_of(seen.truth.force, t, beside)
    turning = Motion(turning.rate, turning.spin, jerk)
    return replace(seen, truth=replace(seen.truth, motion=turning)).coursed(beside)


def _residuals(task: _Task, motion: FusedMotion, force: Array, gyro: Array) -> tuple[Array, Array]:
    """(T, K, 3) along the sensors' axes."""
    rate, instrument = motion.rate[:, None], task.instrument
    if task.late is not None:
        rate = rate + np.matmul(task.late, motion.spin[:, None, :, None])[..., 0]
    off = force - motion.felt(instrument.r)
    return along(instrument.axes, off), along(instrument.gyro_axes, gyro - rate)


def _widened(motion: FusedMotion, noise: tuple[ChipNoise, ChipNoise]) -> FusedMotion:
    """The covariance by the tails: force and dω/dt stand on the accelerometers, ω on the gyros."""
    factor = np.sqrt([*[noise[0].widening] * 6, *[noise[1].widening] * 3])
    return replace(motion, covariance=motion.covariance * np.outer(factor, factor))
