"""What an array's model holds beside the positions: errors of the rests, and accepted effects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.rests import RestFit
from imucalib.core.course import Course
from imucalib.core.effect import Channel, Context, Motion, Parameter, Response, Truth
from imucalib.core.eigen import eigen
from imucalib.estimators.array.gram import Columns

SMALLEST, LARGEST = 1e-3, 10.0  # believable sizes of an effect, in its typical ones
OPEN = 0.05  # λ at typical size below which a direction says nothing


@dataclass(frozen=True)
class Term:
    """An effect with its estimate.

    name : of the effect, with "@imu3" when it acts on one IMU only; only : that IMU or None
    live : (p, q) its parameters per unit of the q coordinates that the data can determine; the
        others are held at zero
    value, sd : (q,) the coordinates and their prior standard deviations
    found : whether the loop accepted it; otherwise it stands for what the rests left open
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
    def aged(self) -> bool:
        """Whether it says what the chips' own clocks do."""
        return "sample_age" in self.effect.needs

    def parameters(self, imus: Sequence[str]) -> tuple[Parameter, ...]:
        if self.effect.shared:
            return self.effect.each
        return self.effect.of_each(imus if self.only is None else [imus[self.only]])

    def columns(self, motion: BoardMotion) -> Columns:
        return columns_of(self.effect, motion, self.only)

    def reading(self, columns: Columns) -> Array:
        """(T, K, 3) what it adds to the readings of its sensors."""
        return columns.at(self.theta)

    def met(self, course: Course, motion: BoardMotion) -> Course:
        """What its sensors meet of a course, by how much it lets them lag."""
        by = self.lag(motion)[..., None]
        return self.effect.lagged(course, by) if self.effect.lagged and by.any() else course

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

    def moved(self, step: Array, variance: Array) -> Term:
        """After a step of its coordinates, of variance (q,); the size of a found effect is learned
        along."""
        value = self.value + step
        sd = self.sd
        if self.found and value.size:
            size = np.sqrt(np.mean(value**2 + variance))
            sd = np.full_like(self.sd, np.clip(size, SMALLEST, LARGEST))
        return replace(self, value=value, sd=sd)


def lagging(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Those that say when sensors read."""
    return tuple(term for term in terms if term.effect.lagged is not None)


def sensed(terms: Sequence[Term], motion: BoardMotion) -> BoardMotion:
    """The motion as lagging sensors meet it: all that acts on a reading acts on what they meet."""
    late = lagging(terms)
    if motion.courses is None or not late:
        return motion
    rate, force = motion.courses
    met = {"angular_rate": (rate, force), "acceleration": (rate, force)}
    for term in late:
        channel = term.effect.channel
        one, two = met[channel]
        met[channel] = (term.met(one, motion), term.met(two, motion))
    return motion.met(met["angular_rate"], met["acceleration"])


def lost(terms: Sequence[Term], motion: BoardMotion) -> tuple[Array, Array]:
    """(T, K, 3) in board axes: what lagging accelerometers and gyros read less than there is, where
    the motion has its courses."""
    assert motion.courses is not None
    found = []
    for channel, course in (
        ("acceleration", motion.courses[1]),
        ("angular_rate", motion.courses[0]),
    ):
        met = course
        for term in lagging(terms):
            if term.effect.channel == channel:
                met = term.met(met, motion)
        found.append(motion.context.in_common(course.value - met.value))
    return found[0], found[1]


def determined(
    name: str, effect: Response, only: int | None, matrix: Array, beside: Sequence[Term] = ()
) -> Term:
    """A new term at zero, with the directions that the data can determine.

    matrix : (p, p) Gram of its columns in typical sizes, with all else that is fitted taken out;
    beside : the terms that are
    """
    if (
        effect.lagged
        and only is None
        and any(
            t.only is None and not t.aged and t.effect.channel != effect.channel
            for t in lagging(beside)
        )
    ):
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
    each = np.array([p.typical for p in effect.each])
    return np.tile(each, count // len(each))


def columns_of(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Columns of an effect in board axes, per unit of its parameters."""
    basis = motion.turned(effect.basis(motion.truth_of(effect.channel), motion.context))
    gyro = effect.channel == "angular_rate"
    if only is None:
        return Columns(basis, gyro, effect.shared)
    alone = np.zeros_like(basis)
    alone[only] = basis[only]
    return Columns(alone, gyro, shared=True)


def _gain_and_offset(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 12))
    for i in range(3):
        out[..., i, 3 * i : 3 * i + 3] = truth.force
        out[..., i, 9 + i] = 1.0
    return out


def _offset(truth: Truth, context: Context) -> Array:
    return np.broadcast_to(np.eye(3), (*truth.shape, 3))


def _rest(name: str, channel: Channel, each: int) -> Response:
    parameters = tuple(Parameter(f"{name}_{k}", "SI", 1.0, np.inf) for k in range(each))
    basis = _gain_and_offset if channel == "acceleration" else _offset
    return Response(
        name,
        "What the rests left open.",
        "",
        "",
        "",
        each=parameters,
        basis=basis,
        channel=channel,
    )


def rest_terms(rests: RestFit) -> tuple[Term, ...]:
    """Errors of gains and offsets with the covariance that the rests left, in package axes."""
    size = 12 * len(rests.gain)
    values, vectors = eigen(rests.covariance.reshape(size, size))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    count = 3 * len(rests.gain)
    back = np.zeros((count // 3, 3, count // 3, 3))
    every = np.arange(count // 3)
    back[every, :, every] = rests.rotations.transpose(0, 2, 1)
    slow = back.reshape(count, count) * rests.gyro_bias_sd.ravel()
    terms = []
    for effect, live in (
        (_rest("rests", "acceleration", 12), root),
        (_rest("rests_gyro", "angular_rate", 3), slow),
    ):
        n = live.shape[1]
        terms.append(Term(effect.name, effect, None, live, np.zeros(n), np.ones(n), found=False))
    return tuple(terms)
