"""A board's motion as effects take it, and the terms of a model that act on it.

Every triad has its truth in its own axes. Terms are what a model holds beyond the positions: errors
of the rests, and accepted effects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.core.course import Course, course_of
from imucalib.core.effect import Basis, Channel, Context, Motion, Parameter, Response, Truth
from imucalib.core.eigen import eigen
from imucalib.estimators.array.samples import Columns, Pair

SMALLEST, LARGEST = 1e-3, 10.0  # believable sizes of an effect, in its typical ones
OPEN = 0.05  # λ at typical size below which a direction says nothing


@dataclass(frozen=True)
class BoardMotion:
    """The truth at T instants as K triads see it, and what else is known of it; of_gyros : the
    same for gyros, where they or the accelerometers lag; courses : of the rate and of the specific
    force as they are, where sensors may lag"""

    truth: Truth
    context: Context
    of_gyros: Truth | None = None
    courses: tuple[Course, Course] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(T, K)."""
        return self.context.n, len(self.context.triads)

    def turn_to_board(self, basis: Array) -> Array:
        """(K, T, 3, m) in board axes, of a basis (T, K, 3, m) in each package's."""
        attitude = self.context.attitude
        assert attitude is not None
        t, k, _, m = basis.shape
        out = np.zeros((k, t, 3, m))
        # Mountings are mostly signed permutations: of nine products three are there.
        for triad, i, j in np.argwhere(attitude):
            out[triad, :, i] += attitude[triad, i, j] * basis[:, triad, j]
        return out

    def set_ages(self, age: Array | None) -> BoardMotion:
        """With the (T, K) sawtooth ages of the gyros' readings, or without any."""
        rest = {k: v for k, v in self.context.covariates.items() if k != "sample_age"}
        known = rest if age is None else {**rest, "sample_age": age}
        return replace(self, context=replace(self.context, covariates=known))

    def set_courses(self, neighbours: Flags) -> BoardMotion:
        """With the courses of rate and force, of which lagging sensors meet a part.

        neighbours : (T, 2) whether the sample before and the one after are next to it
        """
        turning, t = self.truth.turning, self.context["time"]
        rate, force = (
            course_of(value, slope, t, neighbours)
            for value, slope in ((turning.rate, turning.spin), (self.truth.force, turning.jerk))
        )
        return replace(self, courses=(rate, force))

    def set_met(self, gyros: tuple[Course, Course], forces: tuple[Course, Course]) -> BoardMotion:
        """Where gyros and accelerometers meet these courses of rate and force."""
        of_gyros, truth = (
            Truth(force.value, Motion(rate.value, rate.slope, force.slope))
            for rate, force in (gyros, forces)
        )
        return replace(self, of_gyros=of_gyros, truth=truth)

    def truth_of(self, channel: Channel) -> Truth:
        """What the sensors of a kind are exposed to when they read."""
        if channel == "angular_rate" and self.of_gyros is not None:
            return self.of_gyros
        return self.truth

    def take(self, rows: Index) -> BoardMotion:
        """The motion at some of the instants, without what neighbours tell."""
        of_gyros = self.of_gyros and self.of_gyros.take(rows)
        return BoardMotion(self.truth.take(rows), self.context.take(rows), of_gyros)

    @property
    def age(self) -> Array | None:
        return self.context.covariates.get("sample_age")


class Mounted(Protocol):
    """IMUs with the rotations (K, 3, 3) of their packages' axes to the board's."""

    @property
    def imus(self) -> tuple[str, ...]: ...
    @property
    def rotations(self) -> Array: ...


def board_motion(
    board: Mounted,
    t: Array,
    *,
    order: Array | None = None,
    rate: Array | None = None,
    spin: Array | None = None,
    force: Array | None = None,
    jerk: Array | None = None,
    age: Array | None = None,
) -> BoardMotion:
    """From the board's axes; what is not given is zero.

    board : whose IMUs see it; t : (T,) s; order : (T,) 0..1 over the motion, by default in its
    middle; rate, spin : (T, 3) rad/s, rad/s²; force, jerk : (T, K, 3) m/s², m/s³; age : (T, K) or
    None
    """

    def turn_back(vector: Array | None) -> Array:
        if vector is None:
            return np.zeros((len(t), len(board.imus), 3))
        each = vector if vector.ndim == 3 else vector[:, None]
        return np.asarray((each[:, :, None] @ board.rotations)[:, :, 0])

    truth = Truth(turn_back(force), Motion(turn_back(rate), turn_back(spin), turn_back(jerk)))
    known = {"order": np.full(len(t), 0.5) if order is None else order, "time": t}
    context = Context(len(t), known, board.imus, attitude=board.rotations, moving=True)
    return BoardMotion(truth, context).set_ages(age)


@dataclass(frozen=True)
class Term:
    """An effect with its estimate.

    name : of the effect, with "@imu3" when it acts on one IMU only; only : that IMU or None
    live : (p, q) its parameters per unit of the q coordinates that the data can determine; the
        others are held at zero
    value, sd : (q,) the coordinates and their prior standard deviations
    found : whether the loop accepted it; otherwise it is what the rests did not determine
    """

    name: str
    effect: Response
    only: int | None
    live: Array
    value: Array
    sd: Array
    found: bool = True

    @property
    def theta(self) -> Array:
        """(p,) in the parameters' units."""
        return np.asarray(self.live @ self.value)

    @property
    def family(self) -> str:
        """The effect's name, be it of one IMU or of all."""
        return self.name.partition("@")[0]

    @property
    def aged(self) -> bool:
        """Whether it says what the chips' own clocks do."""
        return "sample_age" in self.effect.needs

    @property
    def gyro(self) -> bool:
        """Whether it acts on gyros."""
        return self.effect.channel == "angular_rate"

    def parameters(self, imus: Sequence[str]) -> tuple[Parameter, ...]:
        if self.effect.shared:
            return self.effect.each
        return self.effect.of_each(imus if self.only is None else [imus[self.only]])

    def columns(self, motion: BoardMotion) -> Columns:
        return columns_of(self.effect, motion, self.only)

    def reading(self, motion: BoardMotion) -> Array:
        """(T, K, 3) what it adds to the readings of its sensors."""
        return self.columns(motion).at(self.theta)

    def slope_at_rest(self, board: Mounted, at: float = 0.0) -> tuple[Array, Array]:
        """Gain (K, 3, 3) and offset (K, 3): what it adds per unit of force or rate, and without
        any. at : s, for effects of time"""
        h, small = 1e-4, np.zeros((4, 3))
        small[1:] = h * np.eye(3)
        t, age = np.full(4, at), np.zeros((4, len(board.imus)))
        rate, force = (small, None) if self.gyro else (None, small)
        made = self.reading(board_motion(board, t, rate=rate, force=force, age=age))
        return np.asarray((made[1:] - made[:1]).transpose(1, 2, 0) / h), np.asarray(made[0])

    def beyond(self, motion: BoardMotion, gain: Array, offset: Array) -> Array:
        """(T, K, 3) what it adds less a gain (K, 3, 3) and an offset (K, 3)."""
        drive = motion.truth.turning.rate if self.gyro else motion.truth.force
        linear = np.einsum("kij,tkj->tki", gain, motion.context.in_common(drive)) + offset
        return np.asarray(self.reading(motion) - linear)

    def lag(self, motion: BoardMotion) -> Array:
        """(T, K) s by which its sensors lag: its answer to a change by one a second; zero of what
        does not say when they read."""
        late = np.zeros(motion.shape)
        if self.effect.lagged is None:
            return late
        along = np.zeros(motion.truth.shape)
        along[..., 0] = 1.0
        steady = replace(motion.truth, motion=Motion(along, along, along))
        basis = self.effect.basis(steady, motion.context)[:, :, 0]
        each = self.theta.reshape(-1, basis.shape[2])  # of all, of each or of one IMU
        some = slice(None) if self.only is None else slice(self.only, self.only + 1)
        late[:, some] = -np.sum(basis[:, some] * each, axis=2)
        return late

    def move(self, step: Array, variance: Array) -> Term:
        """After a step of its coordinates, of variance (q,); the size of a found effect is learned
        along."""
        value = self.value + step
        sd = self.sd
        if self.found and value.size:
            size = np.sqrt(np.mean(value**2 + variance))
            sd = np.full_like(self.sd, np.clip(size, SMALLEST, LARGEST))
        return replace(self, value=value, sd=sd)


def select_lagging(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Those that say when sensors read."""
    return tuple(term for term in terms if term.effect.lagged is not None)


def lag_motion(terms: Sequence[Term], motion: BoardMotion) -> BoardMotion:
    """The motion as lagging sensors meet it: all that acts on a reading acts on what they meet."""
    late = select_lagging(terms)
    if motion.courses is None or not late:
        return motion
    rate, force = motion.courses

    def lag_both(channel: Channel) -> tuple[Course, Course]:
        return _lag_course(late, rate, motion, channel), _lag_course(late, force, motion, channel)

    return motion.set_met(lag_both("angular_rate"), lag_both("acceleration"))


def _lag_course(
    late: Sequence[Term], course: Course, motion: BoardMotion, channel: Channel
) -> Course:
    """What sensors of one kind meet of a course."""
    for term in late:
        lag = term.lag(motion)[..., None]
        if term.effect.channel == channel and term.effect.lagged and lag.any():
            course = term.effect.lagged(course, lag)
    return course


def evaluate_lags(terms: Sequence[Term], motion: BoardMotion) -> Pair:
    """(T, K, 3) in board axes: what lags add to the readings, where the motion has its courses."""
    assert motion.courses is not None
    rate, force = motion.courses
    late, common = select_lagging(terms), motion.context.in_common
    return Pair(
        common(_lag_course(late, force, motion, "acceleration").value - force.value),
        common(_lag_course(late, rate, motion, "angular_rate").value - rate.value),
    )


def determine(
    name: str, effect: Response, only: int | None, matrix: Array, others: Sequence[Term] = ()
) -> Term:
    """A new term at zero, with the directions that the data can determine.

    matrix : (p, p) Gram of its columns in typical sizes, with all else that is fitted taken out;
    others : the terms that are there
    """
    opposite = any(
        t.only is None and not t.aged and t.effect.channel != effect.channel
        for t in select_lagging(others)
    )
    if effect.lagged and only is None and opposite:
        # Delays of both kinds of sensor: what all share is the time itself, which none can show.
        apart = np.eye(len(matrix)) - 1.0 / len(matrix)
        matrix = apart @ matrix @ apart
    values, vectors = eigen(matrix)
    use = values > max(OPEN**2, 1e-9 * float(values[-1]))
    live = typical_of(effect, len(matrix))[:, None] * vectors[:, use]
    rank = int(use.sum())
    return Term(name, effect, only, live, np.zeros(rank), np.ones(rank))


def typical_of(effect: Response, count: int) -> Array:
    """(count,) typical sizes of its columns."""
    return np.resize([p.typical for p in effect.each], count)


def columns_of(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Columns of an effect in board axes, per unit of its parameters."""
    basis = motion.turn_to_board(effect.basis(motion.truth_of(effect.channel), motion.context))
    gyro = effect.channel == "angular_rate"
    if only is None:
        return Columns(basis, gyro, effect.shared)
    alone = np.zeros_like(basis)
    alone[only] = basis[only]
    return Columns(alone, gyro, shared=True)


def typical_columns(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Its columns in units of typical sizes, of all IMUs or of one."""
    columns = columns_of(effect, motion, only)
    columns.basis[...] *= typical_of(effect, len(effect.each))
    return columns


def rest_terms(rests: RestFit) -> tuple[Term, ...]:
    """Errors of gains and offsets with the covariance that the rests give them, in package axes."""
    k = len(rests.gain)
    values, vectors = eigen(rests.covariance.reshape(12 * k, 12 * k))
    back = np.zeros((k, 3, k, 3))
    back[range(k), :, range(k)] = rests.rotations.transpose(0, 2, 1)
    gains = vectors * np.sqrt(np.maximum(values, 0.0))
    offsets = back.reshape(3 * k, 3 * k) * rests.gyro_bias_sd.ravel()
    return (
        _of_rests("rests", "acceleration", lambda truth, _: gain_and_offset(truth.force), gains),
        _of_rests("rests_gyro", "angular_rate", _offset, offsets),
    )


def _of_rests(name: str, channel: Channel, basis: Basis, live: Array) -> Term:
    effect = Response(name, "What the rests did not determine.", "", "", "", channel=channel)
    width = 12 if channel == "acceleration" else 3
    each = tuple(Parameter(f"{name}_{k}", "SI", 1.0, np.inf) for k in range(width))
    effect = replace(effect, each=each, basis=basis)
    n = live.shape[1]
    return Term(name, effect, None, live, np.zeros(n), np.ones(n), found=False)


def gain_and_offset(force: Array) -> Array:
    """(T, K, 3, 12) derivative of readings of forces (T, K, 3) by gain, rows first, and offset."""
    each = np.broadcast_to(np.eye(3), (*force.shape, 3))
    gains = np.einsum("...ij,...l->...ijl", each, force).reshape(*force.shape, 9)
    return np.concatenate([gains, each], axis=3)


def _offset(truth: Truth, context: Context) -> Array:
    return np.broadcast_to(np.eye(3), (*truth.shape, 3))
