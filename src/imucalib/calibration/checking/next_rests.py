"""The cheapest next recording: the rests that tell most of a change, until one of the limits' size
would be told.

What rests tell of a change ~ N(0, limit² I) are ½ log det(I + L Cᵀ P C L) nats, L the limits, with
the calibration's own errors taken out, so that what it cannot know is not counted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import Misfits, change_question, misfits_of
from imucalib.calibration.checking.noise import CheckNoise
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, Reference
from imucalib.core.sphere import KnownDirection
from imucalib.posterior.closed_loop.planning import Plan, attitudes, grow_until, nats

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
    kinds = enumerate(misfits.kinds(matters))
    return {name: unit * question.find_detectable(k) for k, (name, unit) in kinds if name in limits}


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
