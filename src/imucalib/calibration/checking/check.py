"""Is a calibration still good? What a few rests or positions say of it, in per cent, what they
could have shown, and the rests to add.

The cheapest next recording is of the rests that tell most of a change, until one of the limits'
size would be told. What rests tell of a change ~ N(0, limit² I) are ½ log det(I + L Cᵀ P C L) nats,
L the limits, with the calibration's own errors taken out, so that what it cannot know is not
counted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import (
    BAD_REST,
    GyroRest,
    Misfits,
    change_question,
    misfits_of,
)
from imucalib.calibration.checking.noise import FAMILIES, CheckNoise, Limits
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, Reference
from imucalib.core.sphere import KnownDirection
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, UsageError
from imucalib.posterior.closed_loop.changes import ChangeAnswer, is_told
from imucalib.posterior.closed_loop.planning import Plan, attitudes, grow_until, nats
from imucalib.units import DEG, MG

Verdict = Literal["still good", "changed", "undecided"]
#: Standard deviations of one corrected reading that a change must reach to matter, where no limit
#: is stated: what is less, single readings of the instrument do not show.
SIGNIFICANT = 5.0
#: Rests that are proposed at most, and numbers beyond, all round, of which the first that does is
#: named.
MOST, MANY = 12, (16, 24, 32, 48, 64, 96, 128, 192, 256)


@dataclass(frozen=True)
class NextRests:
    """direction : (k, 3) unit vectors of the specific force, sensor axes (tool axes with known
    directions), best first; seen : per family, what all rests together could see; enough : whether
    that is within the limits; many : how many all round would do where these do not, None where
    none of `MANY` does"""

    direction: Array
    seen: Mapping[str, float]
    enough: bool
    many: int | None = None


@dataclass(frozen=True)
class ChangeSize:
    """One kind of change. value, sd : (3,) each axis in the kind's unit, beside what else is
    likeliest; NaN where one is open; seen : the size that would have been told"""

    value: Array
    sd: Array
    seen: float


@dataclass(frozen=True)
class SensorCheck:
    """One sensor. name : of an array's IMU, else empty; answer : what changed; sizes : by kind
    false_alarm : chance, at most, with which a change is told where there is none"""

    name: str
    misfits: Misfits
    answer: ChangeAnswer
    sizes: Mapping[str, ChangeSize]
    false_alarm: float
    gyro: GyroRest | None = None

    @property
    def changed(self) -> bool:
        """Whether it is likelier that the sensor changed than not: one rest that is off is none."""
        return is_told(self.answer.probability_that(lambda names: not set(names) <= {BAD_REST}))

    @property
    def disturbed(self) -> bool:
        """Whether something is likelier to be off than not, and it may be one rest alone."""
        return self.answer.told and not self.changed

    @property
    def causes(self) -> tuple[str, ...]:
        """What the likeliest explanation of a change holds."""
        return self.answer.likeliest.names if self.changed else ()

    @property
    def alone(self) -> int | None:
        """Row of the one rest that does not belong to the others, where that is likeliest."""
        likeliest = self.answer.likeliest
        return likeliest.members[0] if self.disturbed and likeliest.names == (BAD_REST,) else None


@dataclass(frozen=True)
class Check:
    """A finished check.

    limits : kind of change -> size in its unit; stated : whether the user gave them
    rate_limit : of a gyroscope's bias, deg/s
    """

    verdict: Verdict
    sensors: tuple[SensorCheck, ...]
    limits: Mapping[str, float]
    stated: bool
    following: NextRests | None
    noise: CheckNoise
    rate_limit: float = math.inf
    notes: tuple[str, ...] = ()

    @property
    def nothing(self) -> float:
        """Probability that no sensor changed."""
        return math.prod(sensor.answer.nothing for sensor in self.sensors)

    @property
    def false_alarm(self) -> float:
        """Chance, at most, with which a change is told where no sensor changed."""
        return min(1.0, sum(sensor.false_alarm for sensor in self.sensors))

    @property
    def exit_code(self) -> int:
        """0 still good, 1 changed, 5 undecided."""
        found = {"still good": 0, "changed": LimitBroken.exit_code}
        return found.get(self.verdict, UNEXPLAINED_EXIT_CODE)

    @property
    def changed(self) -> tuple[SensorCheck, ...]:
        """The sensors that have, by their accelerometers."""
        return tuple(s for s in self.sensors if s.changed)

    @property
    def disturbed(self) -> tuple[SensorCheck, ...]:
        """The sensors of which something is off, which may be one reading."""
        return tuple(s for s in self.sensors if s.disturbed)

    @property
    def drifted(self) -> tuple[SensorCheck, ...]:
        """The sensors whose gyroscope's bias is likelier beyond the limit than within."""
        limit = self.rate_limit
        return tuple(s for s in self.sensors if s.gyro and is_told(s.gyro.chance_beyond(limit)))


@dataclass(frozen=True)
class Measured:
    """What a log says of one sensor, ready to be judged."""

    misfits: Misfits
    name: str = ""
    gyro: GyroRest | None = None


def check(
    calibration: Calibration,
    measured: Sequence[Measured],
    noise: CheckNoise,
    limits: Limits,
    *,
    notes: tuple[str, ...] = (),
) -> Check:
    """Judge a log of one sensor, or of an array's, which share the prior odds of a change.

    A sensor that shows no change is still good where a change of the limit's size would have been
    told. Raises UsageError where nothing tests a limit that is stated.
    """
    first = measured[0].misfits
    _demand_tested(limits, directed=first.directed, gyros=bool(calibration.triads))
    matters = _matters(calibration, first, noise)
    tested = {"bias": "mg", "mounting": "deg"} if first.directed else {"bias": "mg"}
    stated = {kind: limits[unit] for kind, unit in tested.items() if unit in limits}
    wanted = stated or {kind: matters[kind] for kind in tested}
    found = Check(
        verdict="still good",
        sensors=tuple(_judge(one, matters, len(measured)) for one in measured),
        limits=wanted,
        stated=bool(stated),
        following=None,
        noise=noise,
        rate_limit=limits.get("deg/s", math.inf),
        notes=notes,
    )
    if found.changed or found.drifted:
        return replace(found, verdict="changed")
    sized = [(s.sizes[name].seen, limit) for s in found.sensors for name, limit in wanted.items()]
    enough = all(seen <= limit for seen, limit in sized)
    if enough and not found.disturbed:
        return found
    if calibration.triads or enough:
        return replace(found, verdict="undecided")
    following = next_rests(calibration, first, noise, wanted, matters)
    return replace(found, verdict="undecided", following=following)


def _demand_tested(limits: Limits, *, directed: bool, gyros: bool) -> None:
    """Raise UsageError where limits are stated and none can be tested: "still good" would be by
    another one."""
    tested = {"mg": True, "deg": directed, "deg/s": gyros, "mm": False}
    if limits and not any(tested[unit] for unit in limits):
        raise UsageError(
            f"nothing here tests a limit in {', '.join(limits)}",
            remedy="a limit in mg is tested by any rests; deg by known directions, if the "
            "calibration holds a mounting; deg/s by an array's gyros",
        )


def _judge(one: Measured, matters: Mapping[str, float], among: int) -> SensorCheck:
    question = change_question(one.misfits, matters, among)
    answer = question.answer()
    told = [name for name in answer.likeliest.names if name in FAMILIES]
    sizes = {}
    for k, (name, columns) in enumerate(one.misfits.changes.items()):
        beside = [one.misfits.changes[n] for n in told if n != name]
        value, sd = question.size_of(columns, beside)
        sizes[name] = ChangeSize(value, sd, matters[name] * question.find_detectable(k))
    alarm = question.false_alarm()
    return SensorCheck(one.name, one.misfits, answer, sizes, alarm, one.gyro)


def _matters(calibration: Calibration, misfits: Misfits, noise: CheckNoise) -> dict[str, float]:
    """Of every kind of change what readings show: `SIGNIFICANT` sd of one corrected reading."""
    turn = calibration.gravity * DEG  # m/s² of a deg
    if calibration.triads:
        force = across = SIGNIFICANT * float(np.sqrt(np.max(np.diag(misfits.covariance))))
    else:
        force = SIGNIFICANT * one_reading(calibration, noise, directed=False)
        across = SIGNIFICANT * one_reading(calibration, noise, directed=misfits.directed)
    return {"bias": force / MG, "scale": force / MG, "mounting": across / turn}


def next_rests(
    calibration: Calibration,
    now: Misfits,
    noise: CheckNoise,
    limits: Mapping[str, float],
    matters: Mapping[str, float],
) -> NextRests:
    """Rests to add to those of `now` until a change of the limits would be told.

    limits : family -> size in its unit; matters : the same of every kind of change
    """
    pool = _pool(calibration, noise, directed=now.directed)
    single = [pool.take(np.array([k], np.intp)) for k in range(pool.n)]

    def beside(plan: Plan) -> Misfits:
        return reduce(Misfits.join, (single[k] for k in plan), now)

    def worth(plan: Plan) -> Array:
        """(c,) nats of a change; those of attitudes held alike are alike, rounding apart."""
        total = beside(plan)
        return np.round(nats(np.array([_information(total.join(o), limits) for o in single])), 9)

    def detect_with(plan: Plan) -> Mapping[str, float]:
        return (
            _find_detectable(beside(plan), limits, matters)
            if plan
            else dict.fromkeys(limits, np.inf)
        )

    plan = grow_until(worth, MOST, lambda plan: _within(detect_with(plan), limits))
    seen = detect_with(plan)
    direction = np.round(pool.force / np.linalg.norm(pool.force, axis=1, keepdims=True), 3) + 0.0
    enough = _within(seen, limits)
    many = None if enough else _many(now, pool, limits, matters)
    return NextRests(direction[list(plan)], seen, enough, many)


def _within(seen: Mapping[str, float], limits: Mapping[str, float]) -> bool:
    return all(seen[name] <= limit for name, limit in limits.items())


def _find_detectable(
    misfits: Misfits, limits: Mapping[str, float], matters: Mapping[str, float]
) -> dict[str, float]:
    """The change of each limited kind that would be told."""
    question = change_question(misfits, matters)
    kinds = enumerate(misfits.changes)
    return {n: matters[n] * question.find_detectable(k) for k, n in kinds if n in limits}


def _many(
    now: Misfits, pool: Misfits, limits: Mapping[str, float], matters: Mapping[str, float]
) -> int | None:
    """The first number of rests, spread over all attitudes, that would see the limits."""
    for number in MANY:
        less = pool.n / number
        noise = {k: replace(p, covariance=less * p.covariance) for k, p in pool.noise.items()}
        if _within(_find_detectable(now.join(replace(pool, noise=noise)), limits, matters), limits):
            return number
    return None


def _pool(calibration: Calibration, noise: CheckNoise, *, directed: bool) -> Misfits:
    """One rest in each attitude, read as the calibration predicts; session noise is added when
    rests are joined."""
    along, n = attitudes(), len(attitudes())
    context, (model, theta) = calibration.context(n), calibration.model()
    reading = model.predict(theta, calibration.gravity * along[:, None], context).reading
    reference: Reference = KnownNorm(n, calibration.gravity)
    if directed:
        reference = KnownDirection(along, calibration.gravity)
    sigma, label = np.ones((n, 1, 3)), tuple(str(k) for k in range(n))
    observations = Observations(reading, sigma, reference, context, np.arange(n), label)
    setting = dict(noise.setting)
    if "tilt" not in setting and setting:
        setting["tilt"] = max(setting.values(), key=lambda s: s.sd)
    return misfits_of(calibration, observations, replace(noise, setting=setting), fixture=False)[0]


def _information(misfits: Misfits, limits: Mapping[str, float]) -> Array:
    """(q, q) of changes of the limits' size, that which is known before among it."""
    columns = np.concatenate([limits[n] * misfits.changes[n] for n in limits], axis=1)
    inner = columns.T @ np.linalg.solve(misfits.covariance, columns)
    return np.asarray(np.eye(len(inner)) + inner)


def one_reading(calibration: Calibration, noise: CheckNoise, *, directed: bool) -> float:
    """m/s², standard deviation of one corrected reading in the attitude where it is largest: of its
    size, or with known directions of its worst component."""
    pool = _pool(calibration, noise, directed=directed)
    return float(np.sqrt(np.max(np.diag(pool.covariance))))
