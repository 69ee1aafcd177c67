"""What accelerometer and gyroscope of one IMU may do beside bias, scale and gains.

Effects of the accelerometer are those that a bench of rests knows; of the gyroscope those that no
delay is part of, beside laws and free functions of what its axes meet. All are columns of one fit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.array.motion.laws import array_functions, array_laws
from imucalib.calibrators.array.motion.terms import BoardMotion
from imucalib.calibrators.imu.log import LogCourse
from imucalib.calibrators.imu.request import ImuRequest, gyro_effects
from imucalib.calibrators.lab.calibrate import base_model
from imucalib.core.effect import Context, Effect, Motion, Response, Truth
from imucalib.core.observations import Observations
from imucalib.effects import named
from imucalib.estimators.turn_log import TurnLog
from imucalib.estimators.turns import Laws
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.odds import TOGETHER
from imucalib.posterior.search.catalogue import Component, Kind, Member, components_of
from imucalib.units import STANDARD_GRAVITY


class LawTerm(NamedTuple):
    """An effect in the model, or some of its parameters (w,), with the sd of each in its unit."""

    effect: Effect
    own: Index
    sizes: Array

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def of_rate(self) -> bool:
        """Whether it is the gyroscope's."""
        return self.effect.channel == "angular_rate"

    @property
    def key(self) -> str:
        """Which parameters of which effect."""
        return f"{self.name} {self.own}"


def terms_of(member: Member, size: float = 1.0) -> tuple[LawTerm, ...]:
    """The effects of a member, at a size."""
    return tuple(LawTerm(effect, own, size * sizes) for effect, own, sizes in member.effects)


def _whole(effect: Effect, context: Context, size: float = 1.0) -> LawTerm:
    typical = np.array([p.typical for p in effect.parameters(context)])
    return LawTerm(effect, np.arange(typical.size), size * typical)


def declare_terms(request: ImuRequest, rests: Context) -> tuple[LawTerm, ...]:
    """Those of the base model, held by no more than ten times their usual size. rests : what an
    accelerometer's effects may follow"""
    every = {**gyro_effects(request.extra_effects), **request.extra_effects}
    effects = (every[n] if n in every else named(n) for n in request.declare)
    return tuple(_whole(effect, rests, 10.0) for effect in effects)


def laws_of(terms: Sequence[LawTerm], course: LogCourse) -> Laws | None:
    """The columns of terms side by side, or None. course : what they may follow"""
    if not terms:
        return None

    def rate(rate: Array, force: Array, t: Array) -> Array:
        truth, context = exposure(rate, force, t, course)
        return np.concatenate(
            [
                _columns(term, truth, context) if term.of_rate else _nothing(term, t.size)
                for term in terms
            ],
            axis=2,
        )

    def force(up: Array) -> Array:
        truth = Truth(course.gravity * up[:, None])
        return np.concatenate(
            [
                _nothing(term, len(up))
                if term.of_rate
                else _columns(term, truth, course.rests) / course.gravity
                for term in terms
            ],
            axis=2,
        )

    return Laws(rate, force)


def _columns(term: LawTerm, truth: Truth, context: Context) -> Array:
    """(n, 3, w) per unit of each of a term's parameters."""
    effect = term.effect
    start = np.array([p.start for p in effect.parameters(context)])
    return np.asarray(effect.act(start, truth, context).d_theta[:, 0][..., term.own])


def _nothing(term: LawTerm, n: int) -> Array:
    return np.zeros((n, 3, term.own.size))


def exposure(rate: Array, force: Array, t: Array, course: LogCourse) -> tuple[Truth, Context]:
    """What effects of a gyroscope act on: rates (n, 3) rad/s in its axes, forces (n, 3) g, at times
    (n,) s."""
    none = np.zeros((len(rate), 1, 3))
    truth = Truth(STANDARD_GRAVITY * force[:, None], Motion(rate[:, None], none, none))
    return truth, course.context(t)


def components_of_both(
    log: TurnLog, course: LogCourse, rests: Observations, request: ImuRequest
) -> tuple[tuple[Component, ...], dict[str, str]]:
    """Names, unnamed laws and free functions of both sensors; and why effects of the gyroscope
    could not be tried. rests : as a bench has them"""
    bench = request.of_rests
    wanted = effects_to_search(request.only, request.without, request.extra_effects)
    at_rest = components_of(base_model(bench, rests), rests, wanted)
    turning, missing = _of_gyroscope(log, course, request)
    return (*turning, *at_rest), missing


def _of_gyroscope(
    log: TurnLog, course: LogCourse, request: ImuRequest
) -> tuple[tuple[Component, ...], dict[str, str]]:
    t, rate, force = (
        np.concatenate([getattr(turn, name) for turn in log.turns])
        for name in ("t", "rate", "force")
    )
    truth, context = exposure(rate, force, t, course)
    found: dict[str, tuple[Kind, str, list[Response]]] = {}
    missing, out = {}, (*request.declare, *request.without)
    for name, effect in gyro_effects(request.extra_effects).items():
        if name in out or (request.only and name not in request.only):
            continue
        if reason := effect.missing(context):
            missing[name] = reason
        else:
            found[name] = "name", "", [effect]
    motion = BoardMotion(truth, context)
    for follows, law in array_laws(motion) if not request.only else ():
        if law.channel == "angular_rate" and not law.lagged:
            found.setdefault(f"another law of {follows}", ("law", follows, []))[2].append(law)
    for follows, free in array_functions(motion) if not request.only else ():
        if free.channel == "angular_rate":
            found[free.name] = "free", follows, [free]
    components = (
        Component(
            name,
            kind,
            tuple(
                Member(((term.effect, term.own, term.sizes),), share - np.log(len(effects)))
                for effect in effects
                for term, share in _parts(effect, kind, context)
            ),
            follows,
        )
        for name, (kind, follows, effects) in found.items()
    )
    return tuple(components), missing


def _parts(effect: Response, kind: Kind, context: Context) -> list[tuple[LawTerm, float]]:
    """All of its parameters together, or one alone, each with its share in logs."""
    whole = _whole(effect, context)
    count = whole.own.size
    if kind == "free" or count == 1:
        return [(whole, 0.0)]
    one = float(np.log((1.0 - TOGETHER) / count))
    alone = (LawTerm(effect, whole.own[[k]], whole.sizes[[k]]) for k in range(count))
    return [(whole, float(np.log(TOGETHER))), *((term, one) for term in alone)]


def side_by_side(
    components: Sequence[Component],
) -> tuple[tuple[LawTerm, ...], Mapping[tuple[str, int, float], int]]:
    """Terms that hold every column of some components once, and where each of these stands."""
    effects, columns = dict[str, Effect](), dict[str, dict[tuple[str, int, float], None]]()
    for member in (member for one in components for member in one.members):
        effects.update({effect.name: effect for effect, _, _ in member.effects})
        for key in member.columns:
            columns.setdefault(key[0], {})[key] = None
    terms = tuple(
        LawTerm(
            effects[name],
            np.array([k for _, k, _ in keys], dtype=np.intp),
            np.array([size for _, _, size in keys]),
        )
        for name, keys in columns.items()
    )
    every = (key for keys in columns.values() for key in keys)
    return terms, {key: k for k, key in enumerate(every)}
