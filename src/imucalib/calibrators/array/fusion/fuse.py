"""The fused motion of a stretch of samples: weights, effects beyond the linear part, clipped axes.

Each round fits the motion of every sample, takes out what the found effects add at that motion, and
weighs each triad by what it leaves. The last one also knows dω/dt from the neighbours' rates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.moving import SLOWEST
from imucalib.calibrators.array.fusion.instrument import Instrument, Stretch, along
from imucalib.calibrators.array.motion.terms import BoardMotion, board_motion
from imucalib.core.course import slope_of
from imucalib.estimators.array.fusion import FusedMotion, Sensed, compute_precision, fuse_samples
from imucalib.estimators.array.noise import ChipNoise
from imucalib.estimators.array.samples import Pair, find_sides

#: Times its range that a clipped rate is first thought to be; times that, where it led to an answer
#: inside the range; weight of that guess; share of one gyro's say along an axis below which gyros
#: do not see it.
_BEYOND, _FARTHER, _FAINT, _GONE = 1.15, (1.4, 2.0), 1e-6, 0.5
_SHORT = 4  # samples from which on lags are undone by the course of the motion
_GOES_ON = 0.5  # correlation of neighbours from which on a correction is motion
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


@dataclass(frozen=True)
class Fused:
    """motion : of every sample, its covariance that of the noise and of the calibration's doubt
    off, rate_off : (T, K, 3) what the sensors' axes read beside it, m/s² and rad/s
    live, rate_live : (T, K, 3) axes that took part; alone : (T,) no gyro saw some part of the rate
    weight, rate_weight : (T, K, 3) of the axes, (m/s²)^-2 and (rad/s)^-2
    timed : (T, K) gyros whose clock is known
    """

    motion: FusedMotion
    off: Array
    rate_off: Array
    live: Flags
    rate_live: Flags
    alone: Flags
    weight: Array
    rate_weight: Array
    timed: Flags

    def take(self, rows: slice | Index) -> Fused:
        own = {n: v[rows] for n, v in vars(self).items() if n != "motion"}
        return Fused(self.motion.take(rows), **own)


def join_blocks(parts: list[Fused]) -> Fused:
    """One after the other."""
    motion, own = (
        {n: np.concatenate([vars(p)[n] for p in some]) for n in vars(some[0]) if n != "motion"}
        for some in ([part.motion for part in parts], parts)
    )
    return Fused(FusedMotion(**motion), **own)


def fuse(
    instrument: Instrument,
    stretch: Stretch,
    noise: tuple[ChipNoise, ChipNoise],
    age: Array | None = None,
    *,
    rounds: int = 4,
    tied: bool = True,
) -> Fused:
    """Fuse the samples of a stretch.

    noise : of accelerometers and gyros
    age : (T, K) sawtooths of the gyros' clocks, NaN for a clock that was not found, or None
    tied : whether neighbours tell of dω/dt; the samples must then follow each other
    """
    work = _Rounds(instrument, stretch, noise, age, tied=tied)
    for turn in range(rounds):
        work.next(turn)
    return work.finish()


def find_turning(instrument: Instrument, stretch: Stretch) -> Flags:
    """(T,) samples that rotate, by their gyros."""
    first = _begin(instrument, stretch, instrument.correct(stretch)[1])[1]
    return np.asarray(np.linalg.norm(first, axis=1) > SLOWEST)


def _begin(
    instrument: Instrument, stretch: Stretch, gyro: Array
) -> tuple[list[Flags], Array, Flags]:
    """(T, K, 3) axes of both kinds that are there and in range, (T, 3) rates to begin from, and
    (T,) where no gyro in range sees some part of it.

    The rates are the median of whole triads; where there is none, those that axes in range say, and
    a little beyond the range what is at its end.
    """
    clipped = instrument.find_clipped(stretch)
    there = np.isfinite(stretch.rate)
    live = [np.isfinite(stretch.acceleration) & ~clipped[0], there & ~clipped[1]]
    whole = np.all(live[1], axis=2)
    some = np.any(whole, axis=1)
    first, alone = np.zeros((len(stretch.t), 3)), np.zeros(len(stretch.t), dtype=np.bool_)
    first[some] = np.nanmedian(np.where(whole[some][..., None], gyro[some], np.nan), axis=1)
    rest = np.flatnonzero(~some)
    if len(rest):
        axes, inside = instrument.axes[1], live[1][rest].astype(float)
        weight = inside + _FAINT * (there & clipped[1])[rest]
        reading = along(axes, gyro[rest]) * np.where((there & clipped[1])[rest], _BEYOND, 1.0)
        matrix = compute_precision(axes, weight).sum(axis=1) + _FAINT**2 * np.eye(3)
        right = np.einsum("tka,kai->ti", weight * reading, axes)
        first[rest] = np.linalg.solve(matrix, right[..., None])[..., 0]
        seen = compute_precision(axes, inside).sum(axis=1)
        alone[rest] = np.linalg.eigvalsh(seen)[:, 0] < _GONE
    return live, first, alone


class _Rounds:
    """Where the rounds stand.

    read : (T, K, 3) corrected readings of accelerometers and gyros; less : those without effects
    live : axes that take part; share : (T, K, 1) of the weights; first : (T, 3) rad/s to begin from
    motion, sensed, weight, off : of the last round, what it was made from and what it leaves
    """

    sensed: Sensed
    weight: Pair
    off: Pair

    def __init__(
        self,
        instrument: Instrument,
        stretch: Stretch,
        noise: tuple[ChipNoise, ChipNoise],
        age: Array | None,
        *,
        tied: bool,
    ) -> None:
        self.instrument, self.t, self.noise, self.tied = instrument, stretch.t, noise, tied
        self.axes = instrument.axes
        self.read = self.less = instrument.correct(stretch)
        self.live, self.first, self.alone = _begin(instrument, stretch, self.read[1])
        self.lost = np.isfinite(stretch.rate) & ~self.live[1] & self.alone[:, None, None]
        shape = stretch.rate.shape[:2]
        self.timed = np.zeros(shape, np.bool_) if age is None else np.isfinite(age)
        self.late = instrument.beyond.late(self.t, None if age is None else np.nan_to_num(age))
        self.share = [np.ones((*shape, 1)), np.ones((*shape, 1))]
        self.motion: FusedMotion | None = None
        usual = float(np.median(np.diff(self.t))) if len(self.t) > 1 else 0.0
        self.beside = find_sides(self.t, _LOST * usual)

    def next(self, turn: int) -> None:
        """One more round."""
        variance = self._variance()
        every = zip(self.live, self.share, variance, strict=True)
        self.weight = Pair(*(np.where(on, share, 0.0) / v for on, share, v in every))
        self.sensed = Sensed(
            force=self.less[0],
            rate=self.less[1],
            force_precision=compute_precision(self.axes[0], self.weight[0]),
            rate_precision=compute_precision(self.axes[1], self.weight[1]),
            late=self.late,
        )
        before = self.first if self.motion is None else self.motion.rate
        motion = fuse_samples(self.sensed, self.instrument.r, before)
        back = np.zeros(len(self.t), dtype=np.bool_)
        if turn == 0:
            motion = self._from_farther_out(motion)
        if turn == 1:  # the effects are out by then: an answer inside the range goes to its end
            inside = self._inside(motion)
            self.live[1] = self.live[1] | inside
            back = np.any(inside, axis=(1, 2))
            motion = replace(motion, rate=np.where(back[:, None], self.first, motion.rate))
        self.motion = motion
        self.less = self._drop_effects(motion)
        self.off = self._residuals(motion)
        self.share = [
            chip.share(np.sum(np.where(on, off**2 / v, 0.0), axis=2), on.sum(axis=2))[..., None]
            for chip, on, off, v in zip(self.noise, self.live, self.off, variance, strict=True)
        ]
        self.share[1][back] = 1.0  # far from where it is pulled to, it would have no say

    def finish(self) -> Fused:
        """With what the neighbours say of dω/dt, and what the calibration leaves open."""
        motion, sensed, r = self.motion, self.sensed, self.instrument.r
        assert motion is not None
        known = spin_by_neighbours(self.t, motion, self.late) if self.tied else None
        if known is not None:
            sensed = replace(sensed, spin=known[0], spin_precision=known[1])
            motion = fuse_samples(sensed, r, motion.rate)
        # By the tails: force and dω/dt stand on the accelerometers, ω on the gyros.
        wide = np.sqrt(np.repeat([one.widening for one in self.noise], (6, 3)))
        covariance = motion.covariance * np.outer(wide, wide)
        if self.instrument.doubt is not None:
            covariance += self.instrument.doubt.propagate(motion, sensed, r, self._expose(motion))
        return Fused(
            motion=replace(motion, covariance=covariance),
            off=self.off[0],
            rate_off=self.off[1],
            live=self.live[0],
            rate_live=self.live[1],
            alone=self.alone,
            weight=self.weight[0],
            rate_weight=self.weight[1],
            timed=self.timed,
        )

    def _variance(self) -> Pair:
        """(T, K, 3) of the axes. A gyro whose clock is not known is off by its age times dω/dt, the
        age anywhere within its span."""
        motion, span = self.motion, self.instrument.beyond.span
        speed = np.linalg.norm(self.first if motion is None else motion.rate, axis=1)
        first, second = (one.variance(speed) for one in self.noise)
        if span > 0.0 and motion is not None:
            spin = np.broadcast_to(motion.spin[:, None], second.shape)
            swing = along(self.axes[1], spin) ** 2
            second = second + span**2 / 12.0 * ~self.timed[..., None] * swing
        return Pair(first, second)

    def _inside(self, motion: FusedMotion) -> Flags:
        """(T, K, 3) clipped axes of samples that no gyro sees whole, whose fused rate lies inside
        the range: there the reading itself, the end of the range, is nearer."""
        if not self.lost.any():
            return self.lost
        read = along(self.axes[1], self.read[1])
        own = along(self.axes[1], np.broadcast_to(motion.rate[:, None], read.shape))
        return np.asarray(self.lost & (own * np.sign(read) < np.abs(read)))

    def _from_farther_out(self, motion: FusedMotion) -> FusedMotion:
        """The motion with answers that lie inside the range, or have the wrong sign, sought again
        from farther out: the rate hangs on its square there, and has more than one answer."""
        for times in _FARTHER:
            rows = np.flatnonzero(np.any(self._inside(motion), axis=(1, 2)))
            if not len(rows):
                break
            start = times * self.first[rows]
            again = fuse_samples(self.sensed.take(rows), self.instrument.r, start)
            motion = motion.put(rows, again)
        return motion

    def _drop_effects(self, motion: FusedMotion) -> Pair:
        """Corrected readings (T, K, 3) less what the effects beyond the linear parts add."""
        beyond = self.instrument.beyond
        if all(part.late and not part.lags for part in beyond.parts):
            return self.read
        seen = self._expose(motion)
        force, gyro = beyond.evaluate(seen)
        if self.tied and beyond.lagging and len(self.t) > _SHORT:
            more = beyond.evaluate_lags(seen.set_courses(self.beside))
            force, gyro = force + _if_smooth(more[0]), gyro + _if_smooth(more[1])
        return self.read.less(Pair(force, gyro))

    def _expose(self, motion: FusedMotion) -> BoardMotion:
        """The motion as effects take it."""
        felt = motion.predict_force(self.instrument.r)
        return board_motion(
            self.instrument.beyond,
            self.t,
            rate=motion.rate,
            spin=motion.spin,
            force=felt,
            jerk=slope_of(felt, self.t, self.beside),
        )

    def _residuals(self, motion: FusedMotion) -> Pair:
        """(T, K, 3) along the sensors' axes."""
        rate = motion.rate[:, None]
        if self.late is not None:
            rate = rate + np.matmul(self.late, motion.spin[:, None, :, None])[..., 0]
        off = self.less.less(Pair(motion.predict_force(self.instrument.r), rate))
        return Pair(*map(along, self.axes, off))


def _if_smooth(more: Array) -> Array | float:
    """A correction (T, K, 3) that goes on from sample to sample, or none: what does not is the
    noise of a second derivative."""
    power = float(np.sum(more**2))
    goes_on = power > 0.0 and float(np.sum(more[1:] * more[:-1])) > _GOES_ON * power
    return more if goes_on else 0.0


def spin_by_neighbours(
    t: Array, motion: FusedMotion, late: Array | None
) -> tuple[Array, Array] | None:
    """dω/dt (T, 3) rad/s² by differences of the neighbours' rates and its inverse variance, zero
    where neighbours are missing; None for too few samples.

    Accelerometers show dω/dt of a sample by itself, with noise over the size of the board. Where
    the motion is slow against the sampling, this shows it far better; where it is not, hardly at
    all. The third difference of the rates tells which: the error of a central difference is its
    size over 6 Δt, to first order (Taylor).

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
