"""Is a calibration still good? The verdict of a few rests or positions, and what they can see."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import GyroRest, Misfits
from imucalib.calibration.checking.next_rests import NextRests, next_rests, one_reading
from imucalib.calibration.checking.noise import CheckNoise, Limits
from imucalib.calibration.checking.statistic import ANYTHING, FamilyTest, Statistic
from imucalib.errors import UNEXPLAINED_EXIT_CODE, LimitBroken, UsageError
from imucalib.units import DEG, MG

Verdict = Literal["still good", "changed", "undecided"]
#: Standard deviations of one corrected reading that a change must reach to matter, where no limit
#: is stated: what is less, single readings of the instrument do not show.
SIGNIFICANT = 5.0
#: Level of the test, over all sensors.
ALPHA = 0.05
#: Chance with which the change that is stated would have been found.
POWER = 0.9
#: p below which a kind of change leaves too much unexplained to be the whole story.
_LEFT = 0.05
#: Readings from which on one of them may be set apart from the others.
_MANY = 8


@dataclass(frozen=True)
class SensorCheck:
    """One sensor. name : of an array's IMU, else empty; p : that nothing changed, over all kinds of
    change; seen : per kind, the change in the worst direction that would have been found
    causes : kinds of change that explain the misfits, the best first, none where none does alone
    together : whether all kinds together explain them, None where they always would
    alone : the row of the one reading without which nothing shows
    """

    name: str
    misfits: Misfits
    tests: Mapping[str, FamilyTest]
    p: float
    seen: Mapping[str, float]
    causes: tuple[str, ...]
    together: bool | None = None
    alone: int | None = None
    gyro: GyroRest | None = None


@dataclass(frozen=True)
class Check:
    """A finished check.

    limits : kind of change -> size in its unit; stated : whether the user gave them
    p : over all sensors (Bonferroni)
    """

    verdict: Verdict
    sensors: tuple[SensorCheck, ...]
    limits: Mapping[str, float]
    stated: bool
    p: float
    following: NextRests | None
    noise: CheckNoise
    rate_limit: float | None = None
    notes: tuple[str, ...] = ()

    @property
    def exit_code(self) -> int:
        """0 still good, 1 changed, 5 undecided."""
        found = {"still good": 0, "changed": LimitBroken.exit_code}
        return found.get(self.verdict, UNEXPLAINED_EXIT_CODE)

    @property
    def changed(self) -> tuple[SensorCheck, ...]:
        """The sensors that have, by their accelerometers and not by one reading alone."""
        return tuple(s for s in self.sensors if self.shows(s) and s.alone is None)

    @property
    def disturbed(self) -> tuple[SensorCheck, ...]:
        """The sensors of which one reading alone does not belong to the rest."""
        return tuple(s for s in self.sensors if self.shows(s) and s.alone is not None)

    def shows(self, sensor: SensorCheck) -> bool:
        """Whether a sensor's readings differ from an unchanged one's beyond chance."""
        return sensor.p * len(self.sensors) <= ALPHA

    @property
    def turned_on(self) -> tuple[SensorCheck, ...]:
        """The sensors whose gyroscope's bias moved beyond chance."""
        number = len(self.sensors)
        return tuple(s for s in self.sensors if s.gyro is not None and s.gyro.p * number <= ALPHA)

    @property
    def drifted(self) -> tuple[SensorCheck, ...]:
        """Of those, the ones beyond the limit that the user set for rates."""
        limit = math.inf if self.rate_limit is None else self.rate_limit
        return tuple(
            s
            for s in self.turned_on
            if s.gyro is not None and float(np.abs(s.gyro.bias).max()) > limit
        )


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
    seed: int = 0,
    notes: tuple[str, ...] = (),
) -> Check:
    """Judge a log of one sensor, or of an array's.

    At level ALPHA over all sensors; a sensor that shows no change is still good where a change of
    the limit's size would have been found with a chance of `POWER`.
    """
    level = ALPHA / len(measured)
    sensors = tuple(_judge(one, level, seed) for one in measured)
    directed = measured[0].misfits.directed
    _demand_tested(limits, directed=directed, gyros=bool(calibration.triads))
    wanted, stated = _limits(calibration, measured[0].misfits, noise, limits)
    found = Check(
        verdict="still good",
        sensors=sensors,
        limits=wanted,
        stated=stated,
        p=min(1.0, len(sensors) * min(s.p for s in sensors)),
        following=None,
        noise=noise,
        rate_limit=limits.get("deg/s"),
        notes=notes,
    )
    if found.changed or found.drifted:
        return replace(found, verdict="changed")
    enough = all(s.seen[name] <= limit for s in sensors for name, limit in wanted.items())
    if enough and not found.disturbed:
        return found
    if calibration.triads or enough:
        return replace(found, verdict="undecided")
    following = next_rests(calibration, measured[0].misfits, noise, wanted, directed=directed)
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


def _judge(one: Measured, level: float, seed: int) -> SensorCheck:
    statistic = Statistic(one.misfits, seed=seed)
    tests = statistic.tested()
    seen = {name: statistic.seen(name, alpha=level, power=POWER) for name in statistic.columns}
    kinds = [name for name in tests if name != ANYTHING]
    causes = [n for n in kinds if tests[n].p <= _LEFT < tests[n].rest]
    together = statistic.rest_of_all()
    return SensorCheck(
        name=one.name,
        misfits=one.misfits,
        tests=tests,
        p=statistic.p(),
        seen=seen,
        causes=tuple(sorted(causes, key=lambda n: tests[n].p)),
        together=None if together is None else together > _LEFT,
        alone=None if causes else _alone(statistic, level),
        gyro=one.gyro,
    )


def _alone(statistic: Statistic, level: float) -> int | None:
    """The row without which nothing shows, where no kind of change explains all rows; None of few:
    one of these may be all that sees a change."""
    misfits = statistic.misfits
    if misfits.n < _MANY or statistic.p() > level:
        return None
    inverse = np.linalg.inv(misfits.covariance)
    power = []
    for row in range(misfits.n):
        own = np.flatnonzero(misfits.owner == row)
        part = inverse[np.ix_(own, own)]
        pull = inverse[own] @ misfits.value
        power.append(float(pull @ np.linalg.solve(part, pull)))
    worst = int(np.argmax(power))
    others = Statistic(misfits.take(np.delete(np.arange(misfits.n), worst)), seed=statistic.seed)
    return worst if others.p() > level else None


def _limits(
    calibration: Calibration, misfits: Misfits, noise: CheckNoise, limits: Limits
) -> tuple[dict[str, float], bool]:
    """Per kind of change; where nothing is stated, `SIGNIFICANT` sd of one corrected reading."""
    force, direction = limits.get("mg"), limits.get("deg") if misfits.directed else None
    stated = force is not None or direction is not None
    if not stated and calibration.triads:
        carried = float(np.sqrt(np.max(np.diag(misfits.covariance))))
        force = SIGNIFICANT * carried / MG
    elif not stated:
        force = SIGNIFICANT * one_reading(calibration, noise, directed=False) / MG
        if misfits.directed:
            angle = one_reading(calibration, noise, directed=True) / calibration.gravity / DEG
            direction = SIGNIFICANT * angle
    sizes = {"bias": force, "mounting": direction}
    return {kind: size for kind, size in sizes.items() if size is not None}, stated
