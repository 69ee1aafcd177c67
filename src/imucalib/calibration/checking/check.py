"""Is a calibration still good? What a few rests or positions say of it, in per cent, and what they
could have shown."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import BAD_REST, GyroRest, Misfits, change_question
from imucalib.calibration.checking.next_rests import NextRests, next_rests, one_reading
from imucalib.calibration.checking.noise import FAMILIES, CheckNoise, Limits
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, UsageError
from imucalib.posterior.closed_loop.changes import ChangeAnswer, is_told
from imucalib.units import DEG, MG

Verdict = Literal["still good", "changed", "undecided"]
#: Standard deviations of one corrected reading that a change must reach to matter, where no limit
#: is stated: what is less, single readings of the instrument do not show.
SIGNIFICANT = 5.0


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
    stated = _select_limits(limits, directed=first.directed)
    tested = ("bias", "mounting")[: 1 + first.directed]
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
    for k, (name, unit) in enumerate(one.misfits.kinds(matters)):
        beside = [one.misfits.changes[n] for n in told if n != name]
        value, sd = question.size_of(one.misfits.changes[name], beside)
        sizes[name] = ChangeSize(value, sd, unit * question.find_detectable(k))
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


def _select_limits(limits: Limits, *, directed: bool) -> dict[str, float]:
    """The limits by the kind of change that they are of."""
    found = {"bias": limits.get("mg"), "mounting": limits.get("deg") if directed else None}
    return {kind: size for kind, size in found.items() if size is not None}
