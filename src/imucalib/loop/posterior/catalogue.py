"""The components that some observations can carry: tables, and no rules about single effects.

Names and scans come from the catalogue (`imucalib.effects`). Beside them stand free functions of
every driver, which hold any smooth course, and unnamed laws, which are as simple as a name but of
another shape: what a name cannot beat has no name.

What may be missing, on one footing: prior odds, and members with columns and weights.

A component is a name of the catalogue, a scan of one, a free function or an unnamed law. Its
members are the ways in which it may act: all parameters or one, a value of a scan, a shape. The
numbers of a member are normal about zero with the same standard deviation in typical sizes, which
itself has a prior (`log_size_prior`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import DAILY, Context, Effect, Family
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import known
from imucalib.effects.forms import curve, shape
from imucalib.loop.candidates import Searched
from imucalib.loop.posterior.odds import KNOWN, LOOSE, MISSING, SCANNED, SPREAD, TOGETHER

#: name : of the catalogue; loose : a scan without physics for one value before another; free : a
#: smooth function of a driver; law : a simple shape of a driver that has no name.
Kind = Literal["name", "loose", "free", "law"]
#: What shares which part of the prior odds.
_SHARE = {"name": KNOWN, "free": KNOWN, "law": KNOWN, "loose": LOOSE}


@dataclass(frozen=True)
class Member:
    """One way in which a component acts.

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

    @property
    def free(self) -> tuple[tuple[str, bytes], ...]:
        """Which parameters of which effects it frees."""
        return tuple((effect.name, own.tobytes()) for effect, own, _ in self.effects)


@dataclass(frozen=True)
class Component:
    """name : as `imucal effects` has it, of a scan without its value ("name@"); driver : what it
    follows, in words, or empty"""

    name: str
    kind: Kind
    members: tuple[Member, ...]
    driver: str = ""

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


#: Terms of free functions: of a response one for so many rows, within bounds; of others.
_ROWS_A_TERM, _RESPONSE_TERMS, _TERMS = 3, (8, 32), 6
#: Of a scan one value is tried for so many observations, where they are many.
_APART = 32
#: Drivers of the bias and the scale, and of dials beside these.
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


def components_of(
    model: Model, data: Observations, asked: Searched, *, walks: bool = False
) -> tuple[Component, ...]:
    """Everything that may be missing from a model of some observations.

    asked : effects and scans that are wanted; where the user limited them, no free function or law
        is left out, so that no name is certain for want of a rival
    walks : whether the noise holds any course of the bias over time, as in a recording, whose rows
        are enough to try a part of a name by itself
    """
    return (
        *_names(model, data, asked.effects, parts=walks),
        *(c for family in asked.families if (c := scan_of(data, family)) is not None),
        *_free(data, walks=walks),
        *_laws(data),
    )


def _usable(data: Observations, effect: Effect, *, parts: bool = False) -> bool:
    """Whether the data can carry an effect: of gravity's size only what the sensor does by itself
    shows, and without `parts` no part of what another effect holds whole."""
    directed = data.reference.directed
    whole = known(effect.part_of) if effect.part_of else None
    if parts and whole is not None:  # one of as many numbers does no better than the whole
        count = len(effect.parameters(data.context)), len(whole.parameters(data.context))
        whole = whole if count[0] >= count[1] else None
    seen = directed or (effect.stage == "sensor" and whole is None)
    wanted = effect.channel == "acceleration" and effect.stage != "mounting"
    return seen and wanted and not effect.missing(data.context)


def _whole(effect: Effect, context: Context) -> tuple[Effect, Index, Array]:
    """An effect with all of its parameters, at their typical sizes."""
    typical = np.array([p.typical for p in effect.parameters(context)])
    return effect, np.arange(typical.size), typical


def _names(
    model: Model, data: Observations, effects: Mapping[str, Effect], *, parts: bool
) -> Iterator[Component]:
    for effect in effects.values():
        if effect.name in model.names or not _usable(data, effect, parts=parts):
            continue
        if members := tuple(_ways(effect, data.context, single=effect.stage == "sensor")):
            yield Component(effect.name, "name", members)


def _ways(effect: Effect, context: Context, *, single: bool) -> Iterator[Member]:
    """All parameters of an effect together, and one alone."""
    _, every, typical = whole = _whole(effect, context)
    count = every.size
    if not count:
        return
    together = np.log(TOGETHER) if single and count > 1 else 0.0
    yield Member((whole,), float(together))
    if single and count > 1:
        each = float(np.log((1.0 - TOGETHER) / count))
        for k in range(count):
            yield Member(((effect, np.array([k]), typical[k : k + 1]),), each)


def scan_of(data: Observations, family: Family, near: Sequence[str] = ()) -> Component | None:
    """A scan as a component: values over all of its range, each with the same weight, which those
    around a value that is `near` share with it."""
    values = family.values(data.context)
    count = max(SCANNED, data.n // _APART)
    some = values[:: max(1, -(-len(values) // count))]
    members, seen = list[Member](), set[str]()
    for text in dict.fromkeys((*some, *near)):
        finer = family.nearby(data.context, text) if text in near else ()
        own = []
        for one in dict.fromkeys((text, *finer)):
            effect = family.member(one)
            if effect.name not in seen and _usable(data, effect):
                seen.add(effect.name)
                own.append(_whole(effect, data.context))
        share = -float(np.log(max(len(own), 1) * len(some)))
        members += [Member((o,), share) for o in own]
    if not members:
        return None
    kind: Kind = "free" if family.free else "loose" if family.unfounded else "name"
    return Component(f"{family.name}@", kind, tuple(members))


def _free(data: Observations, *, walks: bool) -> Iterator[Component]:
    """Smooth functions of every driver: of each axis' own input and of all three, of what is slow,
    and of the dials."""
    low, high = _RESPONSE_TERMS
    terms = int(np.clip(data.n // _ROWS_A_TERM, low, high))
    rough = {a: _curved(data, f"response:{a}:-1:1:{terms}", 1.0) for a in "xyz"}
    smooth = {a: _curved(data, f"response:{a}:-1:1:{low}", 2.0) for a in "xyz"}
    half = float(np.log(0.5))
    for a in "xyz":
        ways = tuple(Member((one[a],), half) for one in (rough, smooth))
        yield Component(f"response of {a}", "free", ways, "response")
    every = tuple(Member(tuple(one.values()), half) for one in (rough, smooth))
    yield Component("response of all axes", "free", every, "response")
    for name in _varying(data, (*_SLOW, DAILY)):
        for what in ("bias", "scale"):
            if not (walks and (what, name) == ("bias", "order")):
                yield _function(data, what, name)
    if data.reference.directed:
        for what in _varying(data, _DIALS):
            for name in _varying(data, (*_DIALS, "order")):
                yield _function(data, what, name)


def _varying(data: Observations, names: Sequence[str]) -> list[str]:
    return [n for n in names if n in data.context and np.ptp(data.context[n]) > 0.0]


def _function(data: Observations, what: str, name: str) -> Component:
    values = data.context[name]
    text = f"{what}:{name}:{values.min():.6g}:{values.max():.6g}:{_TERMS}"
    member = Member((_curved(data, text, 1.0),), 0.0)
    return Component(f"{what} against {name}".replace("_", "-"), "free", (member,), name)


def _curved(data: Observations, text: str, decay: float) -> tuple[Effect, Index, Array]:
    """A curve whose terms are the smaller the quicker they turn."""
    effect = curve(text)
    what, against = text.split(":")[:2]
    _, every, typical = _whole(effect, data.context)
    axes = 3 if what in ("bias", "scale") else 1
    count = every.size // axes
    first = 2 if what == "response" else 1
    order = np.arange(first, count + first)
    if against == "tool_face" and what != "response":
        order = np.tile(np.arange(1, count // 2 + 1), 2)
    return effect, every, np.tile((first / order) ** decay, axes) * typical


def _laws(data: Observations) -> Iterator[Component]:
    """One component a driver, its shape a member."""
    yield _law(data, "response", [f"response:xyz:{text}" for text in _OF_RESPONSE])
    for name in _varying(data, _SLOW):
        yield _law(data, name, [f"bias:{name}:{text}" for text in _courses(data.context[name])])
    for name in _varying(data, (DAILY,)):
        yield _law(data, name, [f"bias:time:sine:{3600.0 * hours:.6g}" for hours in _PERIODS])
    if data.reference.directed:
        for what in _varying(data, _DIALS):
            yield _law(data, what, [f"{what}:{what}:{text}" for text in _of_dial(data, what)])


def _courses(values: Array) -> Iterator[str]:
    """Simple courses over the range of a driver."""
    low, high = float(values.min()), float(values.max())
    span, middle = high - low, 0.5 * (low + high)
    for share in (0.1, 0.25, 0.7):
        yield f"exponential:{share * span:.6g}:{low:.6g}"
        yield f"exponential:{-share * span:.6g}:{high:.6g}"
    yield f"power:2:{middle:.6g}:{0.5 * span:.6g}"
    yield f"power:3:{middle:.6g}:{0.5 * span:.6g}"
    for share in (0.25, 0.5, 0.75):
        yield f"kink:{low + share * span:.6g}"


def _of_dial(data: Observations, what: str) -> Iterator[str]:
    """Courses over a dial's range in degrees; of a whole turn waves and teeth."""
    degrees = np.degrees(data.context[what])
    if what == "tool_face":
        for lobes in (1, 2, 3, 4, 6):
            yield f"sine:{360.0 / lobes:.6g}"
            yield f"saw_tooth:{360.0 / lobes:.6g}:0"
        return
    yield from _courses(degrees)


def _law(data: Observations, driver: str, texts: Sequence[str]) -> Component:
    weight = -float(np.log(len(texts)))
    every = tuple(Member((_whole(shape(text), data.context),), weight) for text in texts)
    return Component(f"another law of {driver}".replace("_", "-"), "law", every, driver)
