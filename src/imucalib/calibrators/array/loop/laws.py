"""What an array's sensors may follow without a name: unnamed laws, and free functions.

A law is as simple as a name, but of another shape: one number an axis of each IMU, as names of
drifts and of non-linearity have it. What such a law of a driver explains as well has no certain
name. A free function is any smooth course of a driver, alike in all packages.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.loop.ages import PHASE, phases_of
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.motion import BoardMotion
from imucalib.calibrators.array.loop.terms import Term, columns_of
from imucalib.core.context import Context
from imucalib.core.course import delayed
from imucalib.core.effect import Channel, Response, cross_matrix, own_axis, three
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.effects.array.sensing_elements import across
from imucalib.estimators.array.gram import Columns
from imucalib.loop.posterior.catalogue import Component, Kind, Member
from imucalib.loop.posterior.odds import TOGETHER
from imucalib.units import DEG, MG


@dataclass(frozen=True)
class Way:
    """A member as the array's model takes it in: an effect of all IMUs, or of one; part : its
    columns among those of its block"""

    name: str
    effect: Response
    only: int | None
    block: int
    part: Index


@dataclass(frozen=True)
class Components:
    """components, with a way for each of their members in order; columns : (blocks,) in typical
    sizes; missing : why effects could not be tried"""

    components: tuple[Component, ...]
    ways: tuple[tuple[Way, ...], ...]
    columns: tuple[Columns, ...]
    missing: dict[str, str]


def components_of(
    motion: BoardMotion, terms: tuple[Term, ...], left_out: frozenset[str]
) -> Components:
    """Every effect and every law.

    terms : of the model; where one has a twin in it, that stands for both; left_out : names that
    are not tried
    """
    every, missing = _every(motion, terms)
    blocks, found = list[Columns](), list[tuple[Component, tuple[Way, ...]]]()
    for name, (kind, driver, forms) in every.items():
        members, ways = list[Member](), list[Way]()
        for effect in forms:
            own = _ways(effect, motion.context.triads, len(blocks))
            columns = _owned(effect, motion)
            kept = [(way, share) for way, share in own if way.name not in left_out]
            if kept and np.isfinite(columns.basis).all() and columns.basis.any():
                blocks.append(columns)
                ways += [way for way, _ in kept]
                members += [_member(way, share) for way, share in kept]
        if ways:
            share = np.log(sum(np.exp(m.log_weight) for m in members))
            fair = (replace(m, log_weight=float(m.log_weight - share)) for m in members)
            found.append((Component(name, kind, tuple(fair), driver), tuple(ways)))
    return Components(
        tuple(c for c, _ in found), tuple(w for _, w in found), tuple(blocks), missing
    )


Forms = tuple[Kind, str, list[Response]]


def _every(motion: BoardMotion, terms: tuple[Term, ...]) -> tuple[dict[str, Forms], dict[str, str]]:
    """Kind, driver and effects of every component, and why others cannot be tried."""
    every, missing = dict[str, Forms](), dict[str, str]()
    held = [term.effect for term in terms]
    for effect in array_catalogue().values():
        if effect.twin:
            continue
        reason = effect.missing(motion.context)
        if reason:
            missing[effect.name] = reason
        else:
            stands = next((e for e in held if e.twin == effect.name), effect)
            every[effect.name] = "name", "", [stands]
    # Their ranges are the motion's: what is in the model stays as it is there.
    same = {effect.name: effect for effect in held}
    for driver, law in array_laws(motion):
        if not law.missing(motion.context):
            forms = every.setdefault(f"another law of {driver}", ("law", driver, []))[2]
            forms.append(same.get(law.name, law))
    for driver, function in array_functions(motion):
        every[function.name] = "free", driver, [same.get(function.name, function)]
    return every, missing


def _ways(effect: Response, imus: tuple[str, ...], block: int) -> Iterator[tuple[Way, float]]:
    """All IMUs together and one alone, each with its share in logs."""
    size, each = len(effect.each), len(effect.each) * len(imus)
    if effect.shared:
        owned = size + (len(imus) * len(phases_of(effect).each) if _aged(effect) else 0)
        yield Way(effect.name, effect, None, block, np.arange(owned)), 0.0
        return
    yield Way(effect.name, effect, None, block, np.arange(each)), float(np.log(TOGETHER))
    for k, imu in enumerate(imus):
        part = np.arange(k * size, (k + 1) * size)
        share = float(np.log((1.0 - TOGETHER) / len(imus)))
        yield Way(f"{effect.name}@{imu}", effect, k, block, part), share


def _member(way: Way, share: float) -> Member:
    each = np.array([p.typical for p in way.effect.each])
    effect = replace(way.effect, name=way.name)
    return Member(((effect, way.part, np.resize(each, way.part.size)),), share)


def typical_columns(effect: Response, motion: BoardMotion, only: int | None = None) -> Columns:
    """Its columns in units of typical sizes, of all IMUs or of one."""
    columns = columns_of(effect, motion, only)
    columns.basis[...] *= np.array([p.typical for p in effect.each])
    return columns


def _owned(effect: Response, motion: BoardMotion) -> Columns:
    """The same with what belongs to it: of clocks what their phases leave of each gyro."""
    own = typical_columns(effect, motion)
    if not _aged(effect):
        return own
    phases = PHASE * typical_columns(phases_of(effect), motion).basis
    k, t, _, m = phases.shape
    apart = np.zeros((k, t, 3, k, m))
    apart[np.arange(k), :, :, np.arange(k)] = phases
    basis = np.concatenate([own.basis, apart.reshape(k, t, 3, k * m)], axis=3)
    return Columns(basis, own.gyro, own.shared)


def _aged(effect: Response) -> bool:
    return "sample_age" in effect.needs


#: How the name of a correction without a cause begins.
CURVE = "curve of "

Shape = Callable[[Array], Array]
Driver = Callable[[Truth], Array]


def _power(p: float) -> Shape:
    return lambda x: np.asarray(np.sign(x) * np.abs(x) ** p)


def _even(p: float) -> Shape:
    return lambda x: np.asarray(np.abs(x) ** p)


def _end(at: float) -> Shape:
    return lambda x: np.sign(x) * np.maximum(np.abs(x) - at, 0.0)


def _soft_end(at: float) -> Shape:
    return lambda x: np.asarray(np.sign(x) * np.maximum(np.abs(x) - at, 0.0) ** 2)


def _settling(u: Array) -> Array:
    return np.exp(-8.0 * u)


def _straight(u: Array) -> Array:
    return 2.0 * u - 1.0


def _bent(u: Array) -> Array:
    return 6.0 * u * (u - 1.0) + 1.0


#: Of what a sensor reads over the most in this motion; and of time over the motion, 0..1.
_OF_INPUT = {
    "to the power 1.5": _power(1.5),
    "beyond a half": _end(0.5),
    "softly beyond a half": _soft_end(0.5),
    "cubed, without sign": _even(3.0),
}
_OF_TIME = {"as it settles": _settling, "bent": _bent}
#: The same where even a straight line has no name.
_OF_PLACE = {"straight": _straight, "bent": _bent}
#: Terms of a free function, Σ_k c_k √2 cos(π k u) / k of its driver scaled to u = 0..1.
_TERMS = 4


@dataclass(frozen=True)
class _Error:
    """What is off, in words; the unit and the typical size of a number of it; whose reading."""

    words: str
    unit: str
    typical: float
    channel: Channel = "acceleration"


_OF_GYRO = _Error("gyro error", "deg/s", 4.0, "angular_rate")
_OF_FORCE = _Error("force error", "mg", 5.0)
_BY_FORCE = _Error("gyro error", "deg/s", 1.0, "angular_rate")
_GYRO_OFFSET = _Error("gyro offset", "deg/s", 0.1, "angular_rate")
_GYRO_SCALE = _Error("gyro scale", "%", 0.2, "angular_rate")
_OFFSET, _SCALE = _Error("offset", "mg", 2.0), _Error("scale", "%", 0.1)
_PLACE = _Error("position", "mm", 0.05)
_DELAY = _Error("gyro delay", "ms", 0.05, "angular_rate")
_TILT = _Error("attitude", "deg", 0.1), _Error("gyro attitude", "deg", 0.1, "angular_rate")
_FREE = _Error("force error", "m/s2", 0.1), _Error("gyro error", "deg/s", 0.3, "angular_rate")


def array_laws(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Driver and law."""
    fast = float(np.abs(motion.truth.turning.rate).max())
    strong = float(np.abs(motion.truth.force).max())
    for words, shape in _OF_INPUT.items():
        yield _law("rate", _OF_GYRO, words, _by_rate(shape, fast))
        yield _law("force", _OF_FORCE, words, _by_force(shape, strong, MG))
        yield _law("force", _BY_FORCE, words, _by_force(shape, strong, DEG))
    for words, shape in _OF_TIME.items():
        yield _law("time", _GYRO_OFFSET, words, _offset(shape, DEG))
        yield _law("time", _GYRO_SCALE, words, _scale(shape, "rate"))
        yield _law("time", _OFFSET, words, _offset(shape, MG))
        yield _law("time", _SCALE, words, _scale(shape, "force"))
    for k, axis in enumerate("xyz"):
        yield _law("force", _PLACE, f"by the sign of its {axis}", _to_one_side(k))
    for error in _TILT:
        yield _law("time", error, "straight", _tilting(_straight, error.channel))
    for words, shape in _OF_PLACE.items():
        yield _law("time", _PLACE, words, _place(shape))
        yield _law("time", _DELAY, words, _delay(shape))


def array_functions(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Driver and free function: each axis' error against the size of rate and force. Against what
    all axes themselves read, positions would follow it."""
    for error in _FREE:
        for driver, of in (("|ω|", _speed), ("|a|", _strength)):
            yield driver, _function(error, driver, of, motion)


def _function(error: _Error, driver: str, of: Driver, motion: BoardMotion) -> Response:
    values = of(motion.truth)
    low, high = float(values.min()), float(values.max())
    k, scale = np.arange(1, _TERMS + 1), DEG if error.channel == "angular_rate" else 1.0

    def basis(truth: Truth, context: Context) -> Array:
        unit = np.clip((of(truth) - low) / max(high - low, 1e-300), 0.0, 1.0)
        curves = scale * np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k
        return np.asarray(np.einsum("tkc,ij->tkijc", curves, np.eye(3)).reshape(*truth.shape, -1))

    equation = (
        f"error_i = Σ_k c_ik √2 cos(π k u) / k, u = (v - {low:.6g}) / {high - low:.6g} in 0..1, "
        f"v = {driver} (SI)"
    )
    return Response(
        name=f"{CURVE}{error.words} against {driver}",
        sentence="A curve without a name.",
        equation=equation,
        source="",
        identify="",
        needs=("rate",),
        each=tuple(
            Parameter(f"{axis}_{j}", error.unit, error.typical, np.inf) for axis in "xyz" for j in k
        ),
        basis=basis,
        channel=error.channel,
        shared=True,
    )


def _law(
    driver: str, error: _Error, words: str, basis: Callable[[Truth, Context], Array]
) -> tuple[str, Response]:
    late = error.unit == "ms"  # of a triad, not of an axis
    each = three("law", error.unit, error.typical, np.inf)
    found = Response(
        name=f"{CURVE}{error.words} against {driver}, {words}",
        sentence="A law without a name.",
        equation=f"error_i = c_i h(v), h {words}, v {driver}",
        source="",
        identify="",
        needs=("order",) if driver == "time" else ("rate",),
        each=each[:1] if late else each,
        basis=basis,
        channel=error.channel,
        lagged=delayed if late else None,
    )
    sensors = "gyros" if error.channel == "angular_rate" else "accelerometers"
    return f"{driver} in {sensors}", found


def _speed(truth: Truth) -> Array:
    return np.asarray(np.linalg.norm(truth.turning.rate, axis=2))


def _strength(truth: Truth) -> Array:
    return np.asarray(np.linalg.norm(truth.force, axis=2))


def _by_rate(shape: Shape, most: float) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: own_axis(DEG * shape(truth.turning.rate / most))


def _by_force(shape: Shape, most: float, unit: float) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: own_axis(unit * shape(truth.force / most))


def _offset(shape: Shape, unit: float) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        course = unit * shape(context["order"])[:, None, None]
        return own_axis(np.broadcast_to(course, truth.shape))

    return basis


def _scale(shape: Shape, what: str) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        seen = truth.turning.rate if what == "rate" else truth.force
        return own_axis(0.01 * shape(context["order"])[:, None, None] * seen)

    return basis


def _tilting(shape: Shape, channel: Channel) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        seen = truth.force if channel == "acceleration" else truth.turning.rate
        turned = cross_matrix(-seen.reshape(-1, 3)).reshape(*truth.shape, 3)
        return np.asarray(DEG * turned * shape(context["order"])[:, None, None, None])

    return basis


def _place(shape: Shape) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        return np.asarray(1e-3 * across(truth) * shape(context["order"])[:, None, None, None])

    return basis


def _to_one_side(axis: int) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        side = np.sign(truth.force[..., axis])
        return np.asarray(1e-3 * across(truth) * side[..., None, None])

    return basis


def _delay(shape: Shape) -> Callable[[Truth, Context], Array]:
    def basis(truth: Truth, context: Context) -> Array:
        late = -1e-3 * shape(context["order"])[:, None, None, None]
        return np.asarray(late * truth.turning.spin[..., None])

    return basis
