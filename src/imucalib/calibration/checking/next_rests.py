"""The cheapest next recording: rests to add, each the one that tells most of a change.

What a set of rests tells of a change ~ N(0, limit² I) is their mutual information (Lindley 1956),
½ log det(I + L Cᵀ V⁻¹ C L) nats, L the limits; the calibration's covariance is in V, so that what
it cannot know is not counted. The best single rest is added until a change of the limits' size
would be seen.

A later recording against its calibration: what acts on it, and its misfits.

Directions that are not known (the attitude of a rest) are projected out as in `core.balance`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration, taken_at
from imucalib.calibration.checking.misfit import FAMILIES, CheckNoise, Misfits, Part
from imucalib.calibration.checking.statistic import Statistic
from imucalib.core.balance import Balanced, balance
from imucalib.core.effect import Context, Truth
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, Reference
from imucalib.core.sphere import KnownDirection
from imucalib.effects import known, named
from imucalib.errors import UnreadableInput
from imucalib.units import MG

#: Of an effect's parameter in the unit of its kind of change.
_PER_UNIT = {"bias": 1.0, "scale": 1e-3, "mounting": 1.0}


@dataclass(frozen=True)
class Acting:
    """The part of a calibration that acts on a recording. at : of its θ among all parameters"""

    model: Model
    theta: Array
    at: Index


def acting(calibration: Calibration, *, fixture: bool) -> Acting:
    """What corrects a reading; `fixture` : also what the bench itself is off by.

    Raises UnreadableInput where the file names effects that are not known.
    """
    skipped = () if fixture else NEVER_APPLIED
    names = dict.fromkeys(p.effect for p in calibration.parameters if p.stage not in skipped)
    unknown = [name for name in names if known(name) is None]
    if unknown:
        raise UnreadableInput(
            f"the calibration uses unknown effects: {', '.join(unknown)}",
            remedy="load the file that defines them with --effects, or update imucal",
        )
    model = Model(tuple(e for name in names if (e := known(name)) is not None))
    at = calibration.places(model)
    theta = np.array([calibration.parameters[k].value for k in at])
    return Acting(model, theta, at)


def misfits_of(
    calibration: Calibration, observations: Observations, noise: CheckNoise, *, fixture: bool = True
) -> tuple[Misfits, tuple[str, ...]]:
    """Misfits of a recording, and what there is to say of how they were made.

    observations : sigma is 1 m/s² where a row has the noise of a reading, more where it is noisier
    fixture : whether known directions were set on the calibration's own bench
    Raises UnreadableInput for a covariate of which not even the calibrated range is known.
    """
    directed = observations.reference.directed
    part, notes = _fitting(acting(calibration, fixture=directed and fixture), observations.context)
    observations, more = _complete(calibration, part.model, observations)
    corrected = part.model.correct(part.theta, observations.reading, observations.context)
    eta = observations.reference.start(corrected)
    at = balance(part.model, part.theta, eta, observations)
    jacobian = np.zeros((at.unit.size, len(calibration.parameters)))
    jacobian[:, part.at] = at.jacobian * at.unit[:, None]
    changes = _changes(part, eta, observations, at)
    return Misfits(
        value=at.residual * at.unit,
        reading=Part(_readings(at, noise, changes["bias"]), noise.reading.dof),
        setting=_settings(at, noise),
        session=noise.session,
        jacobian=jacobian,
        parameters=calibration.covariance,
        changes=changes,
        owner=at.owner,
        label=observations.label,
        force=corrected[:, 0],
        directed=directed,
    ), (*notes, *more)


def _readings(at: Balanced, noise: CheckNoise, bias: Array) -> Array:
    """(N, N) of the readings' noise, rows in their order. bias : (N, 3) m/s² per mg"""
    square = noise.reading.sd**2
    alone = np.diag(square * at.unit**2)
    if noise.shared is None:
        return np.asarray(alone)
    apart = np.abs(np.subtract.outer(at.owner, at.owner))
    together = (bias @ bias.T) * np.exp(-apart / noise.shared.memory) / MG**2
    share = noise.shared.share
    return np.asarray((1.0 - share) * alone + share * square * together)


def _fitting(part: Acting, context: Context) -> tuple[Acting, tuple[str, ...]]:
    """Without effects of the bench whose parameters belong to the rows of the calibration."""
    size = sum(len(e.parameters(context)) for e in part.model.effects)
    if size == part.theta.size:
        return part, ()
    kept = Model(tuple(e for e in part.model.effects if e.stage != "fixture"))
    at = part.theta.size - sum(len(e.parameters(context)) for e in kept.effects)
    gone = ", ".join(e.name for e in part.model.effects if e.stage == "fixture")
    note = f"{gone}: of the bench on the calibration's day, not expected now"
    return Acting(kept, part.theta[at:], part.at[at:]), (note,)


def _complete(
    calibration: Calibration, model: Model, observations: Observations
) -> tuple[Observations, tuple[str, ...]]:
    """With covariates that were not recorded where a later reading finds them; times are the
    calibration's own and mean nothing later."""
    context, notes = observations.context, []
    needed = {name for effect in model.effects for name in effect.needs}
    held = {"order", "time"} & needed | (needed - set(context.covariates))
    found = dict(context.covariates)
    for name in sorted(held):
        if name not in calibration.valid:
            raise UnreadableInput(
                f"the calibration's effects need {name}, which the recording lacks",
                remedy="record it, or calibrate without those effects (--without)",
            )
        value = calibration.unrecorded(name)
        found[name] = np.full(context.n, value)
        notes.append(f"{name} is taken as {taken_at(name)} of the calibration, {value:.3g}")
    return replace(observations, context=replace(context, covariates=found)), tuple(notes)


def _settings(at: Balanced, noise: CheckNoise) -> dict[str, Part]:
    """What the errors of settings do, component by component."""
    found = {}
    for name, matrix in zip(at.component, at.settings, strict=True):
        scatter = noise.setting.get(name)
        if scatter is not None and scatter.sd > 0.0:
            scaled = scatter.sd * matrix * at.unit[:, None]
            found[name] = Part(scaled @ scaled.T, scatter.dof)
    return found


def _changes(
    part: Acting, eta: Array, observations: Observations, at: Balanced
) -> dict[str, Array]:
    """Columns of every kind of change that these readings could show."""
    context = observations.context
    truth = observations.reference.truth(eta)
    force = part.model.predict(part.theta, truth, context).force
    found = {}
    for name in FAMILIES:
        if name == "mounting" and not observations.reference.directed:
            continue
        effect = named(name)
        start = np.zeros(len(effect.parameters(context)))
        slope = effect.act(start, Truth(force), context).d_theta * _PER_UNIT[name]
        found[name] = at.columns(slope) * at.unit[:, None]
    return found


#: Rests that are proposed at most, and numbers beyond, all round, of which the first that does is
#: told.
MOST, MANY = 12, (16, 24, 32, 48, 64, 96, 128, 192, 256)
#: Simulated recordings behind the change that a plan could see.
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
    now: Misfits | None,
    noise: CheckNoise,
    limits: Mapping[str, float],
    *,
    directed: bool,
    most: int = MOST,
    say: Callable[[], None] = lambda: None,
) -> NextRests:
    """Rests to add to those of `now` (none where None) until a change of the limits would be seen.

    limits : family -> size in its unit; directed : whether the new rests have known directions
    """
    pool = _pool(calibration, noise, directed)
    total, chosen = now, np.zeros((0, 3))
    seen = {name: float("inf") for name in limits}
    for _ in range(most):
        gains = [_information(_joined(total, pool, k), limits) for k in range(len(pool.label))]
        best = int(np.argmax(np.round(gains, 9)))
        total = _joined(total, pool, best)
        chosen = np.concatenate([chosen, _direction(pool, best)[None]])
        say()
        statistic = Statistic(total, draws=_DRAWS)
        seen = {name: statistic.seen(name) for name in limits}
        if all(seen[name] <= limit for name, limit in limits.items()):
            return NextRests(chosen, seen, True)
    return NextRests(chosen, seen, False, _many(now, pool, limits))


def _many(now: Misfits | None, pool: Misfits, limits: Mapping[str, float]) -> int | None:
    """The first number of rests, spread over all attitudes, that would see the limits."""
    for number in MANY:
        less = len(pool.label) / number
        each = replace(
            pool,
            reading=replace(pool.reading, covariance=less * pool.reading.covariance),
            setting={
                k: replace(p, covariance=less * p.covariance) for k, p in pool.setting.items()
            },
        )
        statistic = Statistic(each if now is None else now.joined(each), draws=_DRAWS)
        if all(statistic.seen(name) <= limit for name, limit in limits.items()):
            return number
    return None


def _pool(calibration: Calibration, noise: CheckNoise, directed: bool) -> Misfits:
    """One rest in each attitude, read as the calibration foretells; session noise is added when
    rests are joined."""
    part = acting(calibration, fixture=False)
    along, n = attitudes(), len(attitudes())
    previous = {f"previous_{a}": np.zeros(n) for a in "xyz"}
    context = Context(n, {**previous, **calibration.usual(n)})
    force = calibration.gravity * along[:, None]
    reading = part.model.predict(part.theta, force, context).reading
    reference: Reference = KnownNorm(n, calibration.gravity)
    if directed:
        reference = KnownDirection(along, calibration.gravity)
    sigma, label = np.ones((n, 1, 3)), tuple(str(k) for k in range(n))
    observations = Observations(reading, sigma, reference, context, np.arange(n), label)
    setting = dict(noise.setting)
    if "tilt" not in setting and setting:
        setting["tilt"] = max(setting.values(), key=lambda s: s.sd)
    return misfits_of(calibration, observations, replace(noise, setting=setting), fixture=False)[0]


def _direction(pool: Misfits, k: int) -> Array:
    force = pool.force[k]
    return np.asarray(np.round(force / np.linalg.norm(force), 3) + 0.0)


def _joined(now: Misfits | None, pool: Misfits, row: int) -> Misfits:
    more = pool.take(np.array([row], np.intp))
    return more if now is None else now.joined(more)


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
