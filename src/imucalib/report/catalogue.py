"""The catalogue of effects as a document, as JSON and as the page of the documentation."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Annotated

from imucalib.core.effect import Context, Effect, EffectScan, Parameter, Response
from imucalib.data import Data
from imucalib.report.render.document import Column, Document, Facts, Section, Table, Text, capital
from imucalib.report.render.templates import fill

#: Needs as a list of a line each has them.
_SHORT = {
    **{f"previous_{axis}": "previous reading" for axis in "xyz"},
    **{f"approach_{axis}": "previous reading" for axis in "xyz"},
    **{f"{dial}_approach": "approach" for dial in ("inclination", "tool_face")},
}
_PARAMETERS: tuple[Column, ...] = (
    ("parameter", "name", ""),
    ("typical", "typical", "g"),
    ("plausible", "plausible", "g"),
    ("unit", "unit", ""),
)


def _parameters(effect: Effect) -> tuple[Parameter, ...]:
    """Those of one sensor."""
    return effect.parameters(Context(2, sweeps=2))


def _acts_on(effect: Effect) -> str:
    if effect.stage != "sensor":
        return effect.stage
    shared = isinstance(effect, Response) and effect.shared
    sensors = {"acceleration": "accelerometer", "angular_rate": "gyro"}[effect.channel]
    return f"all {sensors}s" if shared else sensors


class ParameterFacts(Data):
    """An unknown of an effect."""

    name: str
    unit: str
    typical: Annotated[float, "Standard deviation that data sheets and practice let one expect."]
    plausible: Annotated[float, "Largest absolute value that is still believed."]


class EffectFacts(Data, name="effect/1"):
    """An effect of the catalogue."""

    name: str
    stage: Annotated[str, "What it acts on."]
    channel: str
    sentence: str
    equation: str
    source: str
    needs: Annotated[tuple[str, ...], "Covariates."]
    identify: Annotated[str, "What to record to find it."]
    parameters: tuple[ParameterFacts, ...]


def describe_effect(effect: Effect) -> EffectFacts:
    """What `imucal effects` tells machines."""
    return EffectFacts.of(effect, parameters=tuple(map(ParameterFacts.of, _parameters(effect))))


def compose_catalogue_document(
    effects: Sequence[Effect], scans: Sequence[EffectScan] = ()
) -> Document:
    """Many effects, by what they act on and need, with those of which the search finds a value too;
    or everything about one."""
    if len(effects) == 1:
        return Document(effects[0].name, Text(effects[0].sentence), (_one(effects[0]),))
    same: dict[str, dict[str, list[str]]] = {}
    for effect in effects:
        same.setdefault(_acts_on(effect), {}).setdefault(_needed(effect), []).append(effect.name)
    sections = tuple(
        Section(
            f"{capital(what)}, by what they need",
            (Facts(tuple((needs, ", ".join(names)) for needs, names in by.items())),),
        )
        for what, by in same.items()
    )
    named = ", ".join(f"{family.name}@" for family in scans)
    verdict = Text(
        f"{len(effects)} effects; `imucal effects NAME` tells one."
        + (f" With a value: {named}." if named else "")
    )
    return Document("Effects", verdict, sections)


def _needed(effect: Effect) -> str:
    short = (_SHORT.get(name, name).replace("_", " ") for name in effect.needs)
    return ", ".join(dict.fromkeys(short)) or "readings alone"


def _needs(effect: Effect) -> str:
    return ", ".join(effect.needs) or "nothing beside the readings"


def _one(effect: Effect) -> Section:
    facts = (
        ("equation", effect.equation),
        ("acts on", _acts_on(effect)),
        ("needs", _needs(effect)),
        ("source", effect.source),
        ("to identify it", effect.identify),
    )
    table = Table.from_columns(_PARAMETERS, _parameters(effect), "Parameters")
    return Section("Effect", (Facts(facts), table))


def _sizes(effect: Effect) -> list[tuple[str, float, float, str]]:
    """Names, typical size, largest and unit of neighbours that share them."""
    same = groupby(_parameters(effect), lambda p: (p.typical, p.plausible, p.unit))
    return [(_name_together([p.name for p in group]), *size) for size, group in same]


def _name_together(names: list[str]) -> str:
    """`bias_{x,y,z}` of three names that begin alike."""
    if len(names) == 1:
        return f"`{names[0]}`"
    letters = enumerate(zip(*names, strict=False))
    start = next((k for k, each in letters if len(set(each)) > 1), len(names[0]))
    return f"`{names[0][:start]}{{{','.join(name[start:] for name in names)}}}`"


def catalogue_markdown(effects: Sequence[Effect], scans: Sequence[EffectScan] = ()) -> str:
    """docs/effects.md: generated, so that it cannot go stale."""
    functions = {"acts_on": _acts_on, "needs": _needs, "sizes": _sizes}
    return str(fill("effects.md.j2", effects=effects, scans=scans, **functions))
