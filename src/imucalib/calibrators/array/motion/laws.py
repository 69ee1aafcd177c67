"""What an array's motion may lack: names of the catalogue, unnamed laws, and free functions.

A law is as simple as a name, but of another shape: one number an axis of each IMU, as names of
drifts and of non-linearity have it. What such a law of a covariate explains as well has no certain
name. A free function is any smooth course of a covariate, the same in all packages.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.motion.ages import PHASE, phases_of
from imucalib.calibrators.array.motion.terms import BoardMotion, Term, typical_columns
from imucalib.calibrators.request import Request
from imucalib.core.course import delay
from imucalib.core.effect import (
    Basis,
    Channel,
    Context,
    Parameter,
    Response,
    Truth,
    cross_matrix,
)
from imucalib.effects import catalogue
from imucalib.effects.array.parts import (
    FORCE,
    RATE,
    SPIN,
    Quantity,
    all_axes,
    displace,
    each_axis,
    one,
    times,
)
from imucalib.errors import UsageError
from imucalib.estimators.array.samples import Columns
from imucalib.posterior.odds import TOGETHER
from imucalib.posterior.search.catalogue import Component, Kind, Member
from imucalib.posterior.search.problem import Choice
from imucalib.units import DEG, MG

#: Typical sizes of what the rests have calibrated already, each in its own unit.
_AFTER_RESTS = {
    "scale": 2e-3,
    "bias": 2.0,
    "quadratic": 0.3,
    "cubic": 0.02,
    "asymmetry": 2.0,
    "cross_axis": 0.3,
    "bias_drift": 2.0,
    "scale_drift": 2.0,
    "warm_up": 2.0,
}
#: How a name begins that speaks of the rests alone.
AT_REST = "at rest: "
#: Effects that are a part of others, which are tried.
_WITHIN = ("non_orthogonality",)
#: How the name of a correction without a cause begins.
CURVE = "curve of "
Shape = Callable[[Array], Array]
_GYRO: Channel = "angular_rate"
#: Of what a sensor reads over the most in this motion.
_OF_INPUT: dict[str, Shape] = {
    "to the power 1.5": lambda x: np.sign(x) * np.abs(x) ** 1.5,
    "beyond a half": lambda x: np.sign(x) * np.maximum(np.abs(x) - 0.5, 0.0),
    "softly beyond a half": lambda x: np.sign(x) * np.maximum(np.abs(x) - 0.5, 0.0) ** 2,
    "cubed, without sign": lambda x: np.abs(x) ** 3.0,
}
#: Of time over the motion, 0..1.
_OF_TIME: dict[str, Shape] = {
    "as it settles": lambda u: np.exp(-8.0 * u),
    "straight": lambda u: 2.0 * u - 1.0,
    "bent": lambda u: 6.0 * u * (u - 1.0) + 1.0,
}
#: What is off by time, and the shapes that have no name.
_DRIFTS, _LINES = ("as it settles", "bent"), ("straight", "bent")
#: Terms of a free function, Σ_k c_k √2 cos(π k u) / k of its covariate scaled to u = 0..1.
_TERMS = 4


def array_catalogue() -> dict[str, Response]:
    """Every effect of the catalogue that acts on a sensor and is linear in its parameters, at the
    size that the rests leave of it, tried on each IMU alone too: what one IMU does is no error of
    all."""
    return {
        name: _set_size(effect)
        for name, effect in catalogue().items()
        if isinstance(effect, Response) and name not in _WITHIN
    }


def _set_size(effect: Response) -> Response:
    typical = _AFTER_RESTS.get(effect.name)
    each = [p if typical is None else replace(p, typical=typical) for p in effect.each]
    return replace(effect, each=tuple(each))


def twins_of(name: str) -> tuple[str, ...]:
    """Effects of the same IMUs whose columns are those of the named one: in a search one is there
    for all, and a refit tells them apart."""
    family, at, imu = name.partition("@")
    effects = array_catalogue()
    if family not in effects:
        return ()
    first = effects[family].twin or family
    twins = (n for n, e in effects.items() if first in (n, e.twin) and n != family)
    return tuple(f"{n}{at}{imu}" for n in twins)


def find_effect(name: str, imus: Sequence[str]) -> Response:
    """The effect that a name means, such as "gyro_scale@imu3" of one IMU.

    Raises UsageError for an unknown effect or IMU.
    """
    family, at, imu = name.partition("@")
    effect = array_catalogue().get(family)
    if effect is None:
        raise UsageError(
            f"no array effect is called '{family}'", remedy="`imucal effects` lists them"
        )
    if at and (effect.shared or imu not in imus):
        reason = "acts on all IMUs alike" if effect.shared else f"has no IMU '{imu}' to act on"
        raise UsageError(f"'{name}': {family} {reason}", remedy=f"IMUs: {', '.join(imus)}")
    return effect


def find_skipped(request: Request, imus: Sequence[str]) -> frozenset[str]:
    """All effects that a search shall not try, those of one IMU with "@imu3". Raises UsageError for
    an unknown name."""
    only, without = request.only, request.without
    for name in (*only, *without):
        find_effect(name, imus)
    every = [n + end for n in array_catalogue() for end in ("", *(f"@{i}" for i in imus))]

    def is_meant(name: str, chosen: Sequence[str]) -> bool:
        return name in chosen or name.partition("@")[0] in chosen

    return frozenset(
        n
        for n in every
        if not request.loop or is_meant(n, without) or (only and not is_meant(n, only))
    )


@dataclass(frozen=True)
class Candidates:
    """components : with their members, of which choices has each with its columns; blocks : the
    columns in typical sizes, one after the other; missing : why effects could not be tried"""

    components: list[Component] = field(default_factory=list)
    choices: list[Choice] = field(default_factory=list)
    blocks: list[Columns] = field(default_factory=list)
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """How many columns there are."""
        return sum(block.size for block in self.blocks)


def candidates_of(
    motion: BoardMotion,
    terms: Sequence[Term],
    skipped: Collection[str],
    among: Collection[str] | None = None,
) -> Candidates:
    """Every effect and every law.

    terms : of the model; where one has a twin in it, that is there for both; skipped : names that
    are not tried; among : components that are tried, where these are not all
    """
    out = Candidates()
    for name, (kind, covariate, forms) in _every(motion, terms, out.missing).items():
        if among is not None and name not in among:
            continue
        found = list[tuple[Member, Index]]()
        for effect in forms:
            every = _members(effect, motion.context.triads)
            members = [one for one in every if one.name not in skipped]
            columns = _add_phases(effect, motion)
            if members and np.isfinite(columns.basis).all() and columns.basis.any():
                found += [(one, out.width + one.effects[0][1]) for one in members]
                out.blocks.append(columns)
        if found:
            whole = float(np.log(sum(np.exp(member.log_weight) for member, _ in found)))
            fair = [replace(m, log_weight=m.log_weight - whole) for m, _ in found]
            out.choices.extend(
                Choice(len(out.components), m, at, m.log_weight)
                for m, (_, at) in zip(fair, found, strict=True)
            )
            out.components.append(Component(name, kind, tuple(fair), covariate))
    return out


def _every(
    motion: BoardMotion, terms: Sequence[Term], missing: dict[str, str]
) -> dict[str, tuple[Kind, str, list[Response]]]:
    """Kind, covariate and effects of every component; of others, why they cannot be tried."""
    every = dict[str, tuple[Kind, str, list[Response]]]()
    # Ranges of laws are the motion's: what is in the model stays as it is there.
    held = {term.family: term.effect for term in terms}
    for effect in array_catalogue().values():
        if effect.twin:
            continue
        if reason := effect.missing(motion.context):
            missing[effect.name] = reason
        else:
            twin = next((e for e in held.values() if e.twin == effect.name), effect)
            every[effect.name] = "name", "", [twin]
    for covariate, law in array_laws(motion):
        if not law.missing(motion.context):
            forms = every.setdefault(f"another law of {covariate}", ("law", covariate, []))[2]
            forms.append(held.get(law.name, law))
    for covariate, function in array_functions(motion):
        every[function.name] = "free", covariate, [held.get(function.name, function)]
    return every


def _members(effect: Response, imus: tuple[str, ...]) -> list[Member]:
    """All IMUs together and one alone, each with its columns among those of the effect."""
    size, k = len(effect.each), len(imus)
    if effect.shared:
        phases = k * len(phases_of(effect).each) if _is_aged(effect) else 0
        return [_member(effect, "", np.arange(size + phases), 1.0)]
    parts = [np.arange(i * size, (i + 1) * size) for i in range(k)]
    share = (1.0 - TOGETHER) / k
    alone = [_member(effect, f"@{i}", part, share) for i, part in zip(imus, parts, strict=True)]
    return [_member(effect, "", np.concatenate(parts), TOGETHER), *alone]


def _member(effect: Response, of: str, part: Index, share: float) -> Member:
    sizes = np.resize([p.typical for p in effect.each], part.size)
    return Member(((replace(effect, name=effect.name + of), part, sizes),), float(np.log(share)))


def _add_phases(effect: Response, motion: BoardMotion) -> Columns:
    """Its columns in typical sizes, and of clocks what their phases leave of each gyro."""
    own = typical_columns(effect, motion)
    if not _is_aged(effect):
        return own
    phases = PHASE * typical_columns(phases_of(effect), motion).basis
    k, t, _, m = phases.shape
    apart = np.zeros((k, t, 3, k, m))
    apart[range(k), :, :, range(k)] = phases
    basis = np.concatenate([own.basis, apart.reshape(k, t, 3, k * m)], axis=3)
    return Columns(basis, own.gyro, own.shared)


def _is_aged(effect: Response) -> bool:
    return "sample_age" in effect.needs


def _tilt(quantity: Quantity) -> Basis:
    """Three numbers, deg: what is sensed is turned about the axes."""
    return lambda truth, context: DEG * cross_matrix(-quantity(truth))


@dataclass(frozen=True)
class _Error:
    """What is off, in words; the unit and the typical size of a number of it; whose reading; what
    one of it does, where that does not go by a shape of what is sensed."""

    words: str
    unit: str
    typical: float
    channel: Channel = "acceleration"
    part: Basis = displace


_PLACE = _Error("position", "mm", 0.05)
#: Covariate, what is sensed, what is off by it, and the unit of that.
_INPUTS = (
    ("rate", RATE, _Error("gyro error", "deg/s", 4.0, _GYRO), DEG),
    ("force", FORCE, _Error("force error", "mg", 5.0), MG),
    ("force", FORCE, _Error("gyro error", "deg/s", 1.0, _GYRO), DEG),
)
_TIMED = (
    (_Error("gyro offset", "deg/s", 0.1, _GYRO, each_axis(one, DEG)), _DRIFTS),
    (_Error("gyro scale", "%", 0.2, _GYRO, each_axis(RATE, 0.01)), _DRIFTS),
    (_Error("offset", "mg", 2.0, part=each_axis(one, MG)), _DRIFTS),
    (_Error("scale", "%", 0.1, part=each_axis(FORCE, 0.01)), _DRIFTS),
    (_Error("attitude", "deg", 0.1, part=_tilt(FORCE)), _LINES[:1]),
    (_Error("gyro attitude", "deg", 0.1, _GYRO, _tilt(RATE)), _LINES[:1]),
    (_PLACE, _LINES),
    (_Error("gyro delay", "ms", 0.05, _GYRO, all_axes(SPIN, -1e-3)), _LINES),
)
_FREE = _Error("force error", "m/s2", 0.1), _Error("gyro error", "deg/s", 0.3, _GYRO)


def array_laws(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Covariate and law."""
    for covariate, quantity, error, unit in _INPUTS:
        most = float(np.abs(quantity(motion.truth)).max())
        for words, shape in _OF_INPUT.items():
            basis = each_axis(_shape(quantity, shape, most), unit)
            yield _law(covariate, error, words, basis)
    for error, names in _TIMED:
        for words in names:
            yield _law("time", error, words, times(error.part, _over_time(_OF_TIME[words])))
    for k, axis in enumerate("xyz"):
        basis = times(_PLACE.part, _side(k))
        yield _law("force", _PLACE, f"by the sign of its {axis}", basis)


def _shape(quantity: Quantity, shape: Shape, most: float) -> Quantity:
    return lambda truth: np.asarray(shape(quantity(truth) / most))


def _over_time(shape: Shape) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: shape(context["order"])


def _side(axis: int) -> Callable[[Truth, Context], Array]:
    return lambda truth, context: np.sign(truth.force[..., axis])


def _law(covariate: str, error: _Error, words: str, basis: Basis) -> tuple[str, Response]:
    late = error.unit == "ms"  # of a triad, not of an axis
    each = tuple(Parameter(f"law_{a}", error.unit, error.typical, np.inf) for a in "xyz")
    found = Response(
        name=f"{CURVE}{error.words} against {covariate}, {words}",
        sentence="A law without a name.",
        equation=f"error_i = c_i h(v), h {words}, v {covariate}",
        source="",
        identify="",
        needs=("order",) if covariate == "time" else ("rate",),
        each=each[:1] if late else each,
        basis=basis,
        channel=error.channel,
        lagged=delay if late else None,
    )
    sensors = "gyros" if error.channel == _GYRO else "accelerometers"
    return f"{covariate} in {sensors}", found


def array_functions(motion: BoardMotion) -> Iterator[tuple[str, Response]]:
    """Covariate and free function: each axis' error against the size of rate and force. Against
    what all axes themselves read, positions would follow it."""
    for error in _FREE:
        for covariate, quantity in (("|ω|", RATE), ("|a|", FORCE)):
            yield covariate, _function(error, covariate, quantity, motion)


def _function(error: _Error, covariate: str, quantity: Quantity, motion: BoardMotion) -> Response:
    sizes = np.linalg.norm(quantity(motion.truth), axis=2)
    low, high = float(sizes.min()), float(sizes.max())
    k, scale = np.arange(1, _TERMS + 1), DEG if error.channel == _GYRO else 1.0

    def basis(truth: Truth, context: Context) -> Array:
        size = np.linalg.norm(quantity(truth), axis=2)
        unit = np.clip((size - low) / max(high - low, 1e-300), 0.0, 1.0)
        curves = scale * np.sqrt(2.0) * np.cos(np.pi * k * unit[..., None]) / k
        return np.asarray(np.einsum("tkc,ij->tkijc", curves, np.eye(3)).reshape(*truth.shape, -1))

    equation = (
        f"error_i = Σ_k c_ik √2 cos(π k u) / k, u = (v - {low:.6g}) / {high - low:.6g} in 0..1, "
        f"v = {covariate} (SI)"
    )
    each = [f"{axis}_{j}" for axis in "xyz" for j in k]
    return Response(
        name=f"{CURVE}{error.words} against {covariate}",
        sentence="A curve without a name.",
        equation=equation,
        source="",
        identify="",
        needs=("rate",),
        each=tuple(Parameter(n, error.unit, error.typical, np.inf) for n in each),
        basis=basis,
        channel=error.channel,
        shared=True,
    )
