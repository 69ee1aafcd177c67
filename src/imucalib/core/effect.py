"""An effect: one named piece of physics that acts on the truth, with its parameters.

Two shapes cover the catalogue. A `Response` adds to the readings of one channel what its sensors
make of the truth: linear in its parameters, reading = truth + Σ basis(truth)·θ. A `Rotation` turns
the specific force before the sensor sees it, about an axis by an angle that is linear in its
parameters. Both act on the truth, never on the reading: the inverse is derived (`model.correct`).

A parameter: a number with a name, a unit, a physical size and a range outside of which it is
not believed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.course import Lagged
from imucalib.core.eigen import eigen
from imucalib.units import DEG

#: Parts of the truth that are there only where the sensors move.
MOTION = ("rate", "spin", "jerk")
#: Covariates that are the time of a recording, the last of which comes again each day.
DAILY = "time_of_day"
CLOCKS = ("order", "record", "time", DAILY)
#: fixture: the reference is off (never applied to new readings); mounting: the triad's attitude in
#: the tool; sensor: what the sensor does. The last two are undone by `apply`.
Stage = Literal["fixture", "mounting", "sensor"]
#: Which sensors' readings an effect adds to: m/s² or rad/s.
Channel = Literal["acceleration", "angular_rate"]


@dataclass(frozen=True)
class Motion:
    """How K triads turn: rate ω (rad/s), spin dω/dt (rad/s²) and jerk, the specific force's
    derivative (m/s³), each (n, K, 3) in every triad's own axes."""

    rate: Array
    spin: Array
    jerk: Array

    def take(self, rows: Index) -> Motion:
        return Motion(self.rate[rows], self.spin[rows], self.jerk[rows])


@dataclass(frozen=True)
class Truth:
    """What K triads are exposed to in n observations, each triad in its own axes.

    force : (n, K, 3) m/s², specific force; motion : None where the sensors rest
    """

    force: Array
    motion: Motion | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, K, 3)."""
        return self.force.shape

    def take(self, rows: Index) -> Truth:
        return Truth(self.force[rows], self.motion and self.motion.take(rows))

    @property
    def turning(self) -> Motion:
        """The motion. Raises ValueError at rest: an effect that asks for it must name it in
        `needs`."""
        if self.motion is None:
            raise ValueError("the sensors rest: there is no motion")
        return self.motion


@dataclass(frozen=True)
class Parameter:
    """One unknown of an effect.

    unit : the unit that a person reads (mg, deg, 1, mg/degC); the effect converts it to SI
    typical : one standard deviation of what data sheets and practice let one expect, in `unit`
    plausible : largest absolute value that is still believed, in `unit`
    start : the value at which the effect is absent
    least : smallest value that is still believed, in `unit`, of what has one sign
    """

    name: str
    unit: str
    typical: float
    plausible: float
    start: float = 0.0
    least: float = -math.inf


@dataclass(frozen=True)
class Context:
    """Covariates by name, each (n,) in SI units (angles in rad, temperature in °C, time in s), or
    (n, K) where every triad has its own.

    Names with a meaning for the catalogue: "order" (0..1 over the recording), "time",
    "temperature", "inclination", "tool_face", "inclination_dial" and "tool_face_dial" (as the
    bench's dials say them, where these count otherwise), "inclination_sense" and "tool_face_sense"
    (-1 where they count the other way), "sweep" (number of the run of rows with the same held
    angle), "inclination_approach" and "tool_face_approach" (-1, 0, +1: the direction from
    which the setting was reached), "previous_x", "previous_y", "previous_z" (m/s²), "approach_x",
    "approach_y", "approach_z" (-1, 0, +1: the side from which an axis came to its reading, where
    nothing lay between), "sample_age"
    ((n, K) sawtooth of unit span, the beat of each gyro's clock).
    `sweeps` counts those of the whole recording, so that a subset keeps the parameters' meaning.
    attitude : (K, 3, 3) from each triad's axes to the common ones, or None where they are the same
    moving : whether the truth has a motion beside the specific force
    """

    n: int
    covariates: Mapping[str, Array] = field(default_factory=dict)
    triads: tuple[str, ...] = ("imu0",)
    sweeps: int = 1
    attitude: Array | None = None
    moving: bool = False

    def __getitem__(self, name: str) -> Array:
        return self.covariates[name]

    def __contains__(self, name: object) -> bool:
        return name in self.covariates or (self.moving and name in MOTION)

    def dial(self, name: str) -> Array:
        """(n,) rad, "inclination" or "tool_face" as its dial counts it."""
        return self.covariates.get(f"{name}_dial", self.covariates[name])

    def sense(self, name: str) -> Array:
        """(n,) +1, or -1 where the dial counts against the angle."""
        return self.covariates.get(f"{name}_sense", np.ones(self.n))

    def take(self, rows: NDArray[np.intp]) -> Context:
        """The context of a subset of the observations; order and time keep their values."""
        picked = {name: values[rows] for name, values in self.covariates.items()}
        return replace(self, n=len(rows), covariates=picked)

    def in_common(self, vectors: Array) -> Array:
        """(n, K, 3) in the common axes, of vectors (n, K, 3) in each triad's own."""
        if self.attitude is None:
            return vectors
        return np.asarray((self.attitude @ vectors[..., None])[..., 0])

    def in_own(self, columns: Array) -> Array:
        """(n, K, 3, m) in each triad's own axes, of columns (n, 1 or K, 3, m) in common ones."""
        shape = (len(columns), len(self.triads), *columns.shape[2:])
        if self.attitude is None:
            return np.broadcast_to(columns, shape)
        return np.asarray(self.attitude.transpose(0, 2, 1) @ columns)


@dataclass(frozen=True)
class Action:
    """What an effect does, in the unit of its channel (m/s² or rad/s).

    delta : (n, K, 3), added to the truth
    d_theta : (n, K, 3, p) per unit of each parameter
    d_x : (n, K, 3, 3) derivative of delta by the specific force
    """

    delta: Array
    d_theta: Array
    d_x: Array


class Effect(Protocol):
    """The contract of the catalogue. Law tests run over every effect that is found."""

    @property
    def name(self) -> str: ...
    @property
    def channel(self) -> Channel: ...
    @property
    def stage(self) -> Stage: ...
    @property
    def sentence(self) -> str: ...
    @property
    def equation(self) -> str: ...
    @property
    def source(self) -> str: ...
    @property
    def identify(self) -> str: ...
    @property
    def needs(self) -> tuple[str, ...]: ...
    @property
    def part_of(self) -> str: ...
    def parameters(self, context: Context) -> tuple[Parameter, ...]: ...
    def missing(self, context: Context) -> str:
        """Why the context cannot carry the effect; empty when it can."""
        ...

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        """What the effect adds to the truth, zero at θ = 0, and its slopes."""
        ...


@dataclass(frozen=True)
class Described:
    """The words of an effect, shown by `imucal effects` and written into every calibration.

    needs : covariates of the context, which must be there and vary, or parts of the motion
    identify : how to record data that determines it and separates it from its aliases
    part_of : the effect that holds all that the size of gravity alone shows of it, or nothing
    remedy : what to do about it where one triad of many has it alone, or nothing
    """

    name: str
    sentence: str
    equation: str
    source: str
    identify: str
    needs: tuple[str, ...] = ()
    part_of: str = field(default="", kw_only=True)
    remedy: str = field(default="", kw_only=True)

    def missing(self, context: Context) -> str:
        for name in self.needs:
            if name not in context:
                return f"no {name.replace('_', ' ')} was recorded"
            if name in context.covariates and np.ptp(context[name]) <= 0.0:
                return f"{name.replace('_', ' ')} does not vary"
        return ""


Basis = Callable[[Truth, Context], Array]


@dataclass(frozen=True)
class Response(Described):
    """A sensor effect, linear in its parameters, the same shape on every triad.

    each : parameters of one triad, m of them, in the basis' order; of all triads when `shared`
    basis : (truth, context) -> (n, K, 3, m), m/s² or rad/s per unit
    basis_dx : (truth, context) -> (n, K, 3, m, 3), its derivative by the specific force, or None
        where it does not depend on it
    total : (theta, truth, context) -> (n, K, 3), what all parameters add together, where that is
        far less work than the basis
    lagged : where it says when sensors read: what is met of a quantity by sensors that lag; θ and
        the basis give the lag, and what else acts on a reading acts on what is met then
    twin : an effect whose columns are its own, up to what `lagged` makes of them, or those of the
        other kind of sensor that leads: a search has it for both, and a refit tells them apart
    """

    each: tuple[Parameter, ...] = ()
    basis: Basis = lambda truth, context: truth.force[..., None]
    basis_dx: Basis | None = None
    channel: Channel = "acceleration"
    shared: bool = False
    total: Callable[[Array, Truth, Context], Array] | None = None
    lagged: Lagged | None = None
    twin: str = ""

    stage: Stage = "sensor"

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        if self.shared or len(context.triads) == 1:
            return self.each
        return self.of_each(context.triads)

    def of_each(self, triads: Sequence[str]) -> tuple[Parameter, ...]:
        """The parameters of some triads, each named after its triad, in the columns' order."""
        return _of_each(self.each, tuple(triads))

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        basis = self.basis(truth, context)
        columns = basis if self.shared else _side_by_side(basis)
        if not theta.any():  # a candidate: its columns are all that is asked for
            return Action(np.zeros(truth.shape), columns, np.zeros((*truth.shape, 3)))
        table = theta.reshape(-1, len(self.each))
        slope = None if self.basis_dx is None else self.basis_dx(truth, context)
        if truth.shape[1] == 1:
            delta = (basis[:, 0] @ table[0])[:, None]
            if slope is None:
                return Action(delta, basis, np.zeros((*truth.shape, 3)))
            turned = slope[:, 0].transpose(0, 1, 3, 2) @ table[0]
            return Action(delta, basis, turned[:, None])
        table = np.broadcast_to(table, (truth.shape[1], len(self.each)))
        d_x = np.zeros((*truth.shape, 3))
        if slope is not None:
            d_x = np.asarray(np.einsum("nkimj,km->nkij", slope, table))
        return Action(np.asarray(np.einsum("nkim,km->nki", basis, table)), columns, d_x)


@lru_cache(maxsize=512)
def _of_each(each: tuple[Parameter, ...], triads: tuple[str, ...]) -> tuple[Parameter, ...]:
    """Made once: a search asks for those of its candidates at every fit."""
    return tuple(replace(p, name=f"{triad}.{p.name}") for triad in triads for p in each)


def _side_by_side(basis: Array) -> Array:
    """(n, K, 3, K m): each triad's parameters act on that triad only."""
    n, k, _, m = basis.shape
    if k == 1:
        return basis
    d_theta = np.zeros((n, k, 3, k, m))
    for triad in range(k):
        d_theta[:, triad, :, triad] = basis[:, triad]
    return d_theta.reshape(n, k, 3, k * m)


@dataclass(frozen=True)
class EffectScan:
    """Effects that differ in one value that the search has to find: a time, a lag, an axis.

    example : a value, to show one
    member : value as text -> the effect "name@value", the same for the same text anywhere
    values : context -> texts to try; nearby : (context, text) -> finer ones around the best, or
        nothing where the values are all there are
    unfounded : whether no physics speaks for one value before another, so that it has to stand out
        as far as a curve does
    free : whether it is a free function, which names no cause
    """

    name: str
    sentence: str
    example: str
    member: Callable[[str], Effect]
    values: Callable[[Context], tuple[str, ...]]
    nearby: Callable[[Context, str], tuple[str, ...]] = lambda context, text: ()
    unfounded: bool = False
    free: bool = False


Turn = Callable[[Context], tuple[Array, Array]]


@dataclass(frozen=True)
class Rotation(Described):
    """A rotation of the truth: successive turns, each about its own axis.

    turns : each gives (axis (n, 3), angle per degree of each parameter (n, p)) from the context;
        the angle of a turn is the weighted sum of the parameters, which are in degrees
    named : parameters, p of them, or a function of the context when their number depends on it
    """

    named: tuple[Parameter, ...] | Callable[[Context], tuple[Parameter, ...]] = ()
    turns: tuple[Turn, ...] = ()
    channel: Channel = "acceleration"
    stage: Stage = "fixture"

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        return self.named(context) if callable(self.named) else self.named

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        turned = x = truth.force
        slope = np.zeros((*x.shape, theta.size))
        total = np.broadcast_to(np.eye(3), (x.shape[0], 3, 3))
        for turn in self.turns:
            axis, weight = turn(context)
            rotation = rotations(axis * (weight @ theta * DEG)[:, None])
            turned = turned @ rotation.transpose(0, 2, 1)
            slope = rotation[:, None] @ slope
            slope += (turned @ -cross_matrix(axis))[..., None] * (weight * DEG)[:, None, None, :]
            total = rotation @ total
        d_x = np.broadcast_to((total - np.eye(3))[:, None], (*x.shape, 3))
        return Action(turned - x, slope, d_x)


@dataclass(frozen=True)
class Turned(Described):
    """A rotation of the truth by any angle, whose three parameters (deg) are the turn's axis times
    its angle: three turns one after the other have no slope of their own where the second is one
    of 90 deg, this one nowhere below 360 deg."""

    each: tuple[Parameter, ...] = ()
    channel: Channel = "acceleration"
    stage: Stage = "mounting"

    def parameters(self, context: Context) -> tuple[Parameter, ...]:
        return self.each

    def act(self, theta: Array, truth: Truth, context: Context) -> Action:
        rotation, along = rotations(theta * DEG), left_jacobian(theta * DEG)
        x = truth.force
        turned = x @ rotation.T
        slope = -DEG * cross_matrix(turned) @ along
        d_x = np.broadcast_to(rotation - np.eye(3), (*x.shape, 3))
        return Action(turned - x, slope, d_x)


def rotations(vectors: Array) -> Array:
    """(..., 3, 3) of rotation vectors (..., 3) rad (Rodrigues' formula)."""
    first, second, _ = _of_angles(vectors)
    cross = cross_matrix(vectors)
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def left_jacobian(vector: Array) -> Array:
    """(3, 3) the small turn, rad, that each number of a rotation vector (3,) adds after it (Sola,
    Deray and Atchuthan 2018, arXiv 1812.01537, eq. 145)."""
    _, second, third = _of_angles(vector)
    cross = cross_matrix(vector)
    return np.asarray(np.eye(3) + second * cross + third * (cross @ cross))


def _of_angles(vectors: Array) -> tuple[Array, Array, Array]:
    """sin a / a, (1 - cos a) / a² and (a - sin a) / a³ (..., 1, 1), by their series at small a."""
    square = np.sum(vectors * vectors, axis=-1)[..., None, None]
    angle = np.sqrt(square)
    small = angle < 1e-4
    safe = np.where(small, 1.0, angle)
    first = np.where(small, 1.0 - square / 6.0, np.sin(safe) / safe)
    second = np.where(small, 0.5 - square / 24.0, (1.0 - np.cos(safe)) / safe**2)
    return first, second, np.where(small, 1.0 / 6.0, (1.0 - first) / safe**2)


def vector_of(rotation: Array) -> Array:
    """(3,) rad, axis times angle of a rotation matrix, at most half a turn, by the eigenvector of
    its quaternion (Bar-Itzhack 2000, J Guid Control Dyn 23, 1085-1087)."""
    r = rotation
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    matrix = np.empty((4, 4))
    matrix[:3, :3] = r + r.T - np.trace(r) * np.eye(3)
    matrix[:3, 3] = matrix[3, :3] = skew
    matrix[3, 3] = np.trace(r)
    q = eigen(matrix)[1][:, -1]
    q = -q if q[3] < 0.0 else q
    size = float(np.linalg.norm(q[:3]))
    return np.asarray(q[:3] * (2.0 * np.arctan2(size, q[3]) / size if size else 2.0))


def cross_matrix(axis: Array) -> Array:
    """(..., 3, 3) with cross_matrix(a) @ v = a × v, of vectors (..., 3)."""
    out = np.zeros((*axis.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -axis[..., 2], axis[..., 1], -axis[..., 0]
    return np.asarray(out - out.swapaxes(-1, -2))


def own_axis(values: Array) -> Array:
    """(n, K, 3, 3): each axis adds its own value (n, K, 3) times its own parameter."""
    return np.asarray(values[..., None] * np.eye(3))
