"""The cheapest next recording: rests to add, each the one that tells most of a change.

What a set of rests tells of a change ~ N(0, limit² I) is their mutual information (Lindley 1956),
½ log det(I + L Cᵀ V⁻¹ C L) nats, L the limits; the calibration's covariance is in V, so that what
it cannot know is not counted. The best single rest is added until a change of the limits' size
would be seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.misfit import Misfits, misfits_of
from imucalib.calibration.checking.noise import CheckNoise
from imucalib.calibration.checking.statistic import Statistic
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, Reference
from imucalib.core.sphere import KnownDirection

#: Rests that are proposed at most, and numbers beyond, all round, of which the first that does is
#: named.
MOST, MANY = 12, (16, 24, 32, 48, 64, 96, 128, 192, 256)
#: Simulated recordings for the change that a plan could see.
_DRAWS = 2000


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


def attitudes() -> Array:
    """(26, 3) faces, edges and corners: attitudes that a hand can hold."""
    grid = np.array([(x, y, z) for x in (0, 1, -1) for y in (0, 1, -1) for z in (0, 1, -1)])
    grid = grid[np.any(grid != 0, axis=1)]
    size = np.linalg.norm(grid, axis=1)
    order = np.argsort(size, kind="stable")
    return np.asarray(grid[order] / size[order, None], np.float64)


def next_rests(
    calibration: Calibration,
    now: Misfits,
    noise: CheckNoise,
    limits: Mapping[str, float],
    *,
    directed: bool,
) -> NextRests:
    """Rests to add to those of `now` until a change of the limits would be seen.

    limits : family -> size in its unit; directed : whether the new rests have known directions
    """
    pool = _pool(calibration, noise, directed)
    single = [pool.take(np.array([k], np.intp)) for k in range(pool.n)]
    total, chosen = now, np.zeros((0, 3))
    seen = {name: float("inf") for name in limits}
    for _ in range(MOST):
        more = [total.joined(one) for one in single]
        best = int(np.argmax(np.round([_information(one, limits) for one in more], 9)))
        total, force = more[best], pool.force[best]
        chosen = np.vstack([chosen, np.round(force / np.linalg.norm(force), 3) + 0.0])
        statistic = Statistic(total, draws=_DRAWS)
        seen = {name: statistic.seen(name) for name in limits}
        if all(seen[name] <= limit for name, limit in limits.items()):
            return NextRests(chosen, seen, True)
    return NextRests(chosen, seen, False, _many(now, pool, limits))


def _many(now: Misfits, pool: Misfits, limits: Mapping[str, float]) -> int | None:
    """The first number of rests, spread over all attitudes, that would see the limits."""
    for number in MANY:
        less = pool.n / number
        noise = {k: replace(p, covariance=less * p.covariance) for k, p in pool.noise.items()}
        each = replace(pool, noise=noise)
        statistic = Statistic(now.joined(each), draws=_DRAWS)
        if all(statistic.seen(name) <= limit for name, limit in limits.items()):
            return number
    return None


def _pool(calibration: Calibration, noise: CheckNoise, directed: bool) -> Misfits:
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


def _information(misfits: Misfits, limits: Mapping[str, float]) -> float:
    """Nats about changes of the limits' size."""
    columns = np.concatenate([limits[n] * misfits.changes[n] for n in limits], axis=1)
    white = misfits.white(columns)
    return 0.5 * float(np.linalg.slogdet(np.eye(columns.shape[1]) + white.T @ white)[1])


def one_reading(calibration: Calibration, noise: CheckNoise, *, directed: bool) -> float:
    """m/s², standard deviation of one corrected reading in the attitude where it is largest: of its
    size, or with known directions of its worst component."""
    pool = _pool(calibration, noise, directed)
    return float(np.sqrt(np.max(np.diag(pool.covariance))))
