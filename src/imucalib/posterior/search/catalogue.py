"""What may be missing, on one footing: tables, and no rules about single effects.

A component is a name of the catalogue (`imucalib.effects`), a scan of one, a free function, which
holds any smooth course of a covariate, or an unnamed law, which is as simple as a name but of
another shape: what a name cannot beat has no name. Its members are how it may act: all parameters
or one, a value of a scan, a shape. The numbers of a member are normal about zero with the same
standard deviation in typical sizes, which itself has a prior (`log_size_prior`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import DAILY, Context, Effect, EffectScan
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import known
from imucalib.effects.forms import curve, shape
from imucalib.posterior.candidates import SearchedEffects
from imucalib.posterior.odds import (
    FALLS,
    KNOWN,
    LOOSE,
    MISSING,
    RESPONSE_TERMS,
    ROWS_A_TERM,
    SPREAD,
    TERMS,
    TOGETHER,
)

#: name : of the catalogue; loose : a scan without physics for one value before another; free : a
#: smooth function of a covariate; law : a simple shape of one that has no name.
Kind = Literal["name", "loose", "free", "law"]
#: What shares which part of the prior odds.
_SHARE = {"name": KNOWN, "free": KNOWN, "law": KNOWN, "loose": LOOSE}
#: What bias and scale may follow, and what dials may beside themselves.
_SLOW, _DIALS = ("order", "temperature"), ("inclination", "tool_face")
#: Periods of a swing that is no day's, in hours.
_PERIODS = (13.0, 16.0, 19.0, 21.5, 27.0, 31.0, 38.0, 46.0)
#: Laws of a response: odd and even powers, ends, kinks (of the input in g).
_OF_RESPONSE = (
    *(f"odd_power:{p}" for p in (1.5, 2)),
    *(f"power:{p}:0:1" for p in (4, 5)),
    "even_power:1.5",
    *(f"saturation:{end}" for end in (0.1, 0.3, 0.5, 0.7)),
    "soft_saturation:0.3",
    *(f"kink:{at}" for at in (0.3, -0.3)),
)
#: What a dial of a whole turn may do: waves and teeth.
_WAVES = (("sine", ""), ("saw_tooth", ":0"))


@dataclass(frozen=True)
class Member:
    """How a component may act.

    effects : that act, each with the parameters (w,) of its own that are free, and their standard
        deviations (w,) relative to each other, in the parameters' units
    log_weight : of its prior probability within the component
    """

    effects: tuple[tuple[Effect, Index, Array], ...]
    log_weight: float

    @property
    def name(self) -> str:
        """What it is called: of several effects the first's."""
        return self.effects[0][0].name

    def values(self, scan: str) -> list[str]:
        """Of a scan ("name@"), at which it acts."""
        return [effect.name.removeprefix(scan) for effect, _, _ in self.effects]

    @property
    def columns(self) -> list[tuple[str, int, float]]:
        """What each of its columns is known by: effect, parameter and size."""
        return [
            (effect.name, int(k), float(size))
            for effect, own, sizes in self.effects
            for k, size in zip(own, sizes, strict=True)
        ]

    @property
    def free(self) -> tuple[tuple[str, bytes], ...]:
        """Which parameters of which effects it frees."""
        return tuple((effect.name, own.tobytes()) for effect, own, _ in self.effects)


@dataclass(frozen=True)
class Component:
    """name : as `imucal effects` has it, of a scan without its value ("name@"); follows : what it
    follows, in words, or empty"""

    name: str
    kind: Kind
    members: tuple[Member, ...]
    follows: str = ""

    @property
    def named(self) -> bool:
        """Whether it names a cause."""
        return self.kind in ("name", "loose")


def log_odds(components: tuple[Component, ...]) -> Array:
    """(C,) log prior odds of each component, beside whatever else is there: names, free functions
    and laws share theirs evenly, and so do loose scans."""
    group = [_group(c.kind) for c in components]
    count = {g: group.count(g) for g in group}
    return np.array([np.log(_SHARE[c.kind] / count[_group(c.kind)]) for c in components])


def _group(kind: Kind) -> str:
    return "loose" if kind == "loose" else "known"


def log_set_prior(odds: Array, members: tuple[int, ...]) -> float:
    """Log prior of a set of components against none: the first says that something is missing."""
    return float(np.log(MISSING) + odds[list(members)].sum()) if members else 0.0


def log_size_prior(size: Array) -> Array:
    """(..., T) log prior of a component's standard deviations (..., T) in typical sizes: flat in
    the logarithm up to the typical one, falling above; normalised over the last axis."""
    over = np.maximum(np.log(size), 0.0) / np.log(SPREAD)
    density = -0.5 * over**2
    return np.asarray(density - np.log(np.exp(density).sum(axis=-1, keepdims=True)))


def components_of(
    model: Model, data: Observations, wanted: SearchedEffects, *, walks: bool = False
) -> tuple[Component, ...]:
    """Everything that may be missing from a model of some observations.

    wanted : effects and scans that are wanted; where the user limited them, no free function or law
        is left out, so that no name is certain for want of a rival
    walks : whether the noise holds any course of the bias over time, as in a recording, whose rows
        are enough to try a part of a name by itself
    """
    return (
        *_names(model, data, wanted.effects, parts=walks),
        *(c for family in wanted.families if (c := scan_of(data, family)) is not None),
        *_functions(data, walks=walks),
        *_laws(data),
    )


def _usable(data: Observations, effect: Effect, *, parts: bool = False) -> bool:
    """Whether the data can carry an effect: of gravity's size only what the sensor does by itself
    shows, and without `parts` no part of what another effect holds whole."""
    if effect.channel != "acceleration" or effect.stage == "mounting":
        return False
    whole = known(effect.part_of) if effect.part_of else None
    if parts and whole is not None:  # one of as many numbers does no better than the whole
        count = len(effect.parameters(data.context)), len(whole.parameters(data.context))
        whole = whole if count[0] >= count[1] else None
    by_size = effect.stage == "sensor" and whole is None
    return (data.reference.directed or by_size) and not effect.missing(data.context)


def _whole(effect: Effect, context: Context) -> tuple[Effect, Index, Array]:
    """An effect with all of its parameters, at their typical sizes."""
    typical = np.array([p.typical for p in effect.parameters(context)])
    return effect, np.arange(typical.size), typical


def _names(
    model: Model, data: Observations, effects: Mapping[str, Effect], *, parts: bool
) -> Iterator[Component]:
    """Effects, of sensors all parameters together or one alone."""
    for effect in effects.values():
        if effect.name in model.names or not _usable(data, effect, parts=parts):
            continue
        _, every, typical = whole = _whole(effect, data.context)
        if effect.stage == "sensor" and every.size > 1:
            each = float(np.log((1.0 - TOGETHER) / every.size))
            alone = (Member(((effect, every[[k]], typical[[k]]),), each) for k in every)
            members = (Member((whole,), float(np.log(TOGETHER))), *alone)
            yield Component(effect.name, "name", members)
        elif every.size:
            yield Component(effect.name, "name", (Member((whole,), 0.0),))


def scan_of(data: Observations, family: EffectScan, about: Sequence[str] = ()) -> Component | None:
    """A scan as a component: every value of it with the same weight, which those around a value
    that is refined share with it; about : values that are"""
    values = family.values(data.context)
    members, seen = list[Member](), set[str]()
    for text in dict.fromkeys((*values, *about)):
        finer = set(family.nearby(data.context, text) if text in about else ()) - set(values)
        effects = [family.member(one) for one in (text, *sorted(finer))]
        new = [e for e in effects if e.name not in seen and _usable(data, e)]
        seen.update(e.name for e in new)
        share = -float(np.log(max(len(new), 1) * len(values)))
        members += [Member((_whole(e, data.context),), share) for e in new]
    if not members:
        return None
    kind: Kind = "free" if family.free else "loose" if family.unfounded else "name"
    return Component(f"{family.name}@", kind, tuple(members))


def _functions(data: Observations, *, walks: bool) -> Iterator[Component]:
    """Smooth functions: of each axis' own input and of all three, of what is slow, of the dials."""
    low, high = RESPONSE_TERMS
    terms = int(np.clip(data.n // ROWS_A_TERM, low, high))
    # What falls as 1 / k² has nothing left beyond the first few.
    many = dict(zip(FALLS, (terms, terms, low), strict=True))
    share = -float(np.log(len(FALLS)))
    axes = {a: [_curve(data, f"response:{a}:-1:1:{many[f]}", f) for f in FALLS] for a in "xyz"}
    for a, curves in axes.items():
        members = tuple(Member((one,), share) for one in curves)
        yield Component(f"response of {a}", "free", members, "response")
    every = tuple(Member(together, share) for together in zip(*axes.values(), strict=True))
    yield Component("response of all axes", "free", every, "response")
    slow = [
        (what, name)
        for name in _select_varying(data, (*_SLOW, DAILY))
        for what in ("bias", "scale")
    ]
    dials = _select_varying(data, _DIALS) if data.reference.directed else []
    turned = [(what, name) for what in dials for name in _select_varying(data, (*_DIALS, "order"))]
    for what, name in (*slow, *turned):
        if not (walks and (what, name) == ("bias", "order")):
            values = data.context[name]
            text = f"{what}:{name}:{values.min():.6g}:{values.max():.6g}:{TERMS}"
            members = tuple(Member((_curve(data, text, f),), share) for f in FALLS)
            title = f"{what} against {name}".replace("_", "-")
            yield Component(title, "free", members, name)


def _select_varying(data: Observations, names: Sequence[str]) -> list[str]:
    return [n for n in names if n in data.context and np.ptp(data.context[n]) > 0.0]


def _curve(data: Observations, text: str, fall: int) -> tuple[Effect, Index, Array]:
    """A curve whose terms of order k are 1 / k^fall of the first."""
    effect, every, typical = _whole(curve(text), data.context)
    largest = typical.max()
    return effect, every, largest * (typical / largest) ** fall


def _laws(data: Observations) -> Iterator[Component]:
    """One component of each covariate, its shape a member."""
    laws = [("response", [f"response:xyz:{text}" for text in _OF_RESPONSE])]
    for name in _select_varying(data, _SLOW):
        laws.append((name, [f"bias:{name}:{text}" for text in _courses(data.context[name])]))
    for name in _select_varying(data, (DAILY,)):
        laws.append((name, [f"bias:time:sine:{3600.0 * hours:.6g}" for hours in _PERIODS]))
    for name in _select_varying(data, _DIALS) if data.reference.directed else ():
        waves = [f"{w}:{360.0 / n:.6g}{end}" for n in (1, 2, 3, 4, 6) for w, end in _WAVES]
        shapes = waves if name == "tool_face" else _courses(np.degrees(data.context[name]))
        laws.append((name, [f"{name}:{name}:{text}" for text in shapes]))
    for name, texts in laws:
        weight = -float(np.log(len(texts)))
        members = tuple(Member((_whole(shape(text), data.context),), weight) for text in texts)
        yield Component(f"another law of {name}".replace("_", "-"), "law", members, name)


def _courses(values: Array) -> Iterator[str]:
    """Simple courses over the range of a covariate."""
    low, high = float(values.min()), float(values.max())
    span, middle = high - low, 0.5 * (low + high)
    for share in (0.1, 0.25, 0.7):
        yield f"exponential:{share * span:.6g}:{low:.6g}"
        yield f"exponential:{-share * span:.6g}:{high:.6g}"
    for power in (2, 3):
        yield f"power:{power}:{middle:.6g}:{0.5 * span:.6g}"
    for share in (0.25, 0.5, 0.75):
        yield f"kink:{low + share * span:.6g}"
