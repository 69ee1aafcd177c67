"""The fused motion of a stretch of samples: weights, effects beyond the linear part, clipped axes.

Each round fits the motion of every sample, takes out what the found effects add at that motion, and
weighs each triad by what it leaves. The last one also knows dω/dt from the neighbours' rates.

What the rates of the samples before and after say of dω/dt, and how far that can be believed.

Accelerometers show dω/dt of a sample by itself, with noise over the size of the board. Where the
motion is slow against the sampling, the difference of the neighbours' rates shows it far better;
where it is not, hardly at all. The third difference of the rates tells which: the error of a
central difference is its size over 6 Δt, to first order (Taylor).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.fused.instrument import Instrument, of_the_calibration
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.loop.motion import BoardMotion, board_motion
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.core.course import slope_of
from imucalib.core.effect import Motion
from imucalib.estimators.array.fusion import FusedMotion, Sensed, fused_motion, precision_of

_BEYOND = 1.15  # times its range that a clipped rate is first thought to be


_FARTHER = (1.4, 2.0)  # times the first guess, where that led to an answer inside the range


_FAINT = 1e-6  # weight of that guess


_GONE = 0.5  # share of one gyro's say along an axis below which gyros do not see it


@dataclass(frozen=True)
class Start:
    """force, gyro : (T, K, 3) corrected by the linear parts, board axes
    live, rate_live : (T, K, 3) axes that are there and in range
    first : (T, 3) rad/s; alone : (T,) no gyro sees some part of the rate
    """

    force: Array
    gyro: Array
    live: Flags
    rate_live: Flags
    first: Array
    alone: Flags


def start_of(instrument: Instrument, stretch: Stretch) -> Start:
    """Corrected readings, and the rates that the gyros say: the median of whole triads; a little
    beyond the range where all gyros are at its end."""
    force, gyro = instrument.corrected(stretch.t, stretch.acceleration, stretch.rate)
    clipped, rate_clipped = instrument.clipped(stretch.acceleration, stretch.rate)
    live = np.isfinite(stretch.acceleration) & ~clipped
    there = np.isfinite(stretch.rate)
    rate_live = there & ~rate_clipped
    whole = np.all(rate_live, axis=2)
    some = np.any(whole, axis=1)
    first = np.zeros((len(stretch.t), 3))
    inner = np.where(whole[some][..., None], gyro[some], np.nan)
    first[some] = np.nanmedian(inner, axis=1)
    alone = np.zeros(len(stretch.t), dtype=np.bool_)
    if not np.all(some):
        rest = ~some
        part = (gyro[rest], rate_live[rest], (there & rate_clipped)[rest])
        first[rest], alone[rest] = _guessed(instrument.gyro_axes, *part)
    return Start(force, gyro, live, rate_live, first, alone)


def turning(instrument: Instrument, stretch: Stretch) -> Flags:
    """(T,) samples that rotate, by their gyros."""
    return np.asarray(np.linalg.norm(start_of(instrument, stretch).first, axis=1) > SLOWEST)


def _guessed(axes: Array, gyro: Array, live: Flags, clipped: Flags) -> tuple[Array, Flags]:
    """Rates (n, 3) of samples without a whole gyro, and where nothing in range sees a part."""
    squares = (axes[:, :, :, None] * axes[:, :, None, :]).reshape(-1, 9)
    reading = np.where(clipped, _BEYOND, 1.0) * along(axes, gyro)
    weight = live + _FAINT * clipped
    matrix = (weight.reshape(len(gyro), -1) @ squares).reshape(-1, 3, 3)
    right = (weight * reading).reshape(len(gyro), -1) @ axes.reshape(-1, 3)
    first = np.linalg.solve(matrix + _FAINT**2 * np.eye(3), right[..., None])[..., 0]
    seen = (live.reshape(len(gyro), -1).astype(float) @ squares).reshape(-1, 3, 3)
    return np.asarray(first, np.float64), np.asarray(np.linalg.eigvalsh(seen)[:, 0] < _GONE)


def outside(
    instrument: Instrument, stretch: Stretch, start: Start, sensed: Sensed, motion: FusedMotion
) -> FusedMotion:
    """The motion with answers that lie inside the range, or have the wrong sign, sought again from
    farther out: the rate hangs on its square there, and has more than one answer."""
    for times in _FARTHER:
        rows = np.flatnonzero(np.any(inside(instrument, stretch, start, motion), axis=(1, 2)))
        if not len(rows):
            break
        again = fused_motion(sensed.take(rows), instrument.r, times * start.first[rows])
        motion = motion.put(rows, again)
    return motion


def inside(instrument: Instrument, stretch: Stretch, start: Start, motion: FusedMotion) -> Flags:
    """(T, K, 3) clipped axes of samples that no gyro sees whole, whose fused rate lies inside the
    range: there the reading itself, the end of the range, is nearer."""
    lost = np.isfinite(stretch.rate) & ~start.rate_live & start.alone[:, None, None]
    if not lost.any():
        return lost
    axes = instrument.gyro_axes
    own = along(axes, np.broadcast_to(motion.rate[:, None], start.gyro.shape))
    read = along(axes, start.gyro)
    return np.asarray(lost & (own * np.sign(read) < np.abs(read)))


_LOST = 1.5  # median intervals between samples from which on they are no neighbours
_SLOW = 0.3  # share of the usual interval by which neighbours may be off
#: Samples over which the error of the difference is judged; and over which, where third differences
#: are hardly more than noise: what noise leaves of the squares of a few is not zero.
_FEW, _QUIET = 9, (27, 81)
#: Times what noise explains up to which that is so, and what a few squares then are at most: the
#: 98 % point of χ² with 3.9 degrees of freedom, those of nine whose correlations are (15/20)²,
#: (6/20)² and (1/20)².
_HARDLY, _MOST = 2.0, 2.9
_JUDGED = 25  # samples over which the accelerometers may contradict it
_ODD = 2.5  # times what noise explains, from which they do


def near_next(t: Array) -> Flags:
    """(T - 1,) whether a sample and the next are neighbours, none being lost between them."""
    step = np.diff(t)
    return np.asarray(step < _LOST * np.median(step))


def spin_by_neighbours(
    t: Array, motion: FusedMotion, late: Array | None
) -> tuple[Array, Array] | None:
    """dω/dt (T, 3) rad/s² by differences and its inverse variance, zero where neighbours are
    missing; None for too few samples.

    late : (T, K, 3, 3) s as in `fusion.Sensed`: the rate that gyros have is that of their mean time
    """
    if len(t) < _JUDGED:
        return None
    rate, variance, after = _as_read(motion, late)
    step = np.diff(t)
    usual = float(np.median(step))
    near = np.abs(step - usual) < _SLOW * usual
    spin, own = np.zeros_like(rate), np.full(rate.shape, np.inf)
    # What gyros read is of `after` seconds later: dω/dt at the stamp is so much of d²ω/dt² less.
    ahead = after[1:-1, None] / usual**2
    spin[1:-1] = (rate[2:] - rate[:-2]) / (2.0 * usual)
    spin[1:-1] -= ahead * (rate[2:] - 2.0 * rate[1:-1] + rate[:-2])
    around = variance[2:] + variance[:-2]
    own[1:-1] = around / (2.0 * usual) ** 2 + ahead**2 * (around + 4.0 * variance[1:-1])
    own[1:-1][~(near[1:] & near[:-1])] = np.inf
    error = _error(rate, variance, near, usual)
    # What the accelerometers see beside it, where that is more than noise: aliased motion.
    theirs = np.einsum("tii->ti", motion.covariance)[:, 3:6]
    known = np.isfinite(own)
    off = np.where(known, (spin - motion.spin) ** 2, 0.0)
    noise = np.where(known, theirs + own, 0.0) + error
    seen, due = _local(off, _JUDGED), _local(noise, _JUDGED)
    error += np.where(seen > _ODD * due, seen - due, 0.0)
    return spin, 1.0 / (own + error)


def _error(rate: Array, variance: Array, near: Flags, usual: float) -> Array:
    """(T, 3) (rad/s²)², the square of what a central difference of the rates is off by."""
    square, noise = np.zeros_like(rate), np.zeros_like(rate)
    whole = (near[2:] & near[1:-1] & near[:-2])[:, None]
    due = variance[3:] + 9.0 * (variance[2:-1] + variance[1:-2]) + variance[:-3]
    square[1:-2] = np.where(whole, np.diff(rate, n=3, axis=0) ** 2, 0.0)
    noise[1:-2] = np.where(whole, due, 0.0)
    few = _local(square, _FEW)
    error = few - _local(noise, _FEW)
    for window in _QUIET:
        many, due = _local(square, window), _local(noise, window)
        quiet = (many < _HARDLY * due) & (few < _MOST * due)
        error = np.where(quiet, many - due, error)
    return np.maximum(error, 0.0) / (6.0 * usual) ** 2


def _as_read(motion: FusedMotion, late: Array | None) -> tuple[Array, Array, Array]:
    """(T, 3) the rate at the gyros' mean time and its variance, in which the spin's noise is not;
    (T,) s by which that time is after the stamp."""
    variance = np.einsum("tii->ti", motion.covariance)
    if late is None:
        return motion.rate, variance[:, 6:], np.zeros(len(motion.rate))
    after = np.einsum("tkii->t", late) / (3.0 * late.shape[1])
    mean = after[:, None]
    cross = np.einsum("tii->ti", motion.covariance[:, 3:6, 6:])
    spread = variance[:, 6:] + 2.0 * mean * cross + mean**2 * variance[:, 3:6]
    return motion.rate + mean * motion.spin, np.maximum(spread, 0.0), after


def _local(values: Array, window: int) -> Array:
    return np.asarray(uniform_filter1d(values, window, axis=0, mode="nearest"))


@dataclass(frozen=True)
class Stretch:
    """Readings of K IMUs at the same instants, in the sensors' own axes; NaN where missing.

    t : (T,) s; acceleration : (T, K, 3) m/s²; rate : (T, K, 3) rad/s
    """

    t: Array
    acceleration: Array
    rate: Array

    def take(self, rows: slice | Index | Flags) -> Stretch:
        return Stretch(self.t[rows], self.acceleration[rows], self.rate[rows])


def along(axes: Array, vectors: Array) -> Array:
    """(T, K, 3) what axes (K, 3, 3), one in a row, see of vectors (T, K, 3)."""
    seen = np.matmul(vectors.transpose(1, 0, 2), axes.transpose(0, 2, 1))
    return np.asarray(seen.transpose(1, 0, 2))


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
            motion=self.motion.take(rows),
            off=self.off[rows],
            rate_off=self.rate_off[rows],
            live=self.live[rows],
            rate_live=self.rate_live[rows],
            alone=self.alone[rows],
            weights=(one[rows], two[rows]),
        )


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
        instrument=instrument,
        stretch=stretch,
        start=start,
        noise=noise,
        age=age,
        late=late,
        tied=tied,
    )
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
        motion=own,
        off=off[0],
        rate_off=off[1],
        live=start.live,
        rate_live=state.rate_live,
        alone=start.alone,
        weights=weights,
    )


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
        force=force,
        gyro=gyro,
        rate_live=rate_live,
        shares=(one, two),
        motion=motion,
        sensed=sensed,
        weights=weights,
        off=off,
    )


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
        imus=instrument.imus,
        rotations=instrument.beyond.rotations,
        t=t,
        order=np.full(len(t), 0.5),
        rate=motion.rate,
        spin=motion.spin,
        force=felt,
        jerk=jerk,
    )


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
