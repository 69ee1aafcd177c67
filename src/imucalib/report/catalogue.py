"""The catalogue of effects as a document, as JSON and as the page of the documentation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucalib.core.effect import Context, Effect, Family, Parameter, Response
from imucalib.report.document import Document, Facts, Section, Table, Text

#: Needs as a list of a line each has them.
_SHORT = {
    **{f"previous_{axis}": "previous reading" for axis in "xyz"},
    **{f"approach_{axis}": "previous reading" for axis in "xyz"},
    **{f"{dial}_approach": "approach" for dial in ("inclination", "tool_face")},
}


def _parameters(effect: Effect) -> tuple[Parameter, ...]:
    """Those of one sensor."""
    return effect.parameters(Context(2, sweeps=2))


def _acts_on(effect: Effect) -> str:
    if effect.stage != "sensor":
        return effect.stage
    shared = isinstance(effect, Response) and effect.shared
    sensors = {"acceleration": "accelerometer", "angular_rate": "gyro"}[effect.channel]
    return f"all {sensors}s" if shared else sensors


def effect_dict(effect: Effect) -> dict[str, Any]:
    """One effect as plain types."""
    return {
        "name": effect.name,
        "stage": effect.stage,
        "channel": effect.channel,
        "sentence": effect.sentence,
        "equation": effect.equation,
        "source": effect.source,
        "needs": list(effect.needs),
        "identify": effect.identify,
        "parameters": [
            {"name": p.name, "unit": p.unit, "typical": p.typical, "plausible": p.plausible}
            for p in _parameters(effect)
        ],
    }


def catalogue_document(effects: Sequence[Effect], scans: Sequence[Family] = ()) -> Document:
    """Many effects, by what they act on and need, with those of which the search finds a value too;
    or everything about one."""
    if len(effects) == 1:
        return Document(effects[0].name, Text(effects[0].sentence), (_one(effects[0]),))
    alike: dict[str, dict[str, list[str]]] = {}
    for effect in effects:
        alike.setdefault(_acts_on(effect), {}).setdefault(_needed(effect), []).append(effect.name)
    sections = tuple(
        Section(
            f"{what[0].upper()}{what[1:]}, by what they need",
            (Facts(tuple((needs, ", ".join(names)) for needs, names in by.items())),),
        )
        for what, by in alike.items()
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


def _sizes(effect: Effect) -> str:
    return ", ".join(dict.fromkeys(f"{p.typical:g} {p.unit}" for p in _parameters(effect)))


def _one(effect: Effect) -> Section:
    rows = tuple(
        (p.name, f"{p.typical:g}", f"{p.plausible:g}", p.unit) for p in _parameters(effect)
    )
    header = ("parameter", "typical", "plausible", "unit")
    return Section(
        "Effect",
        (
            Facts(
                (
                    ("equation", effect.equation),
                    ("acts on", _acts_on(effect)),
                    ("needs", ", ".join(effect.needs) or "nothing beside the readings"),
                    ("source", effect.source),
                    ("to identify it", effect.identify),
                )
            ),
            Table("Parameters", header, rows, "lrrl"),
        ),
    )


def catalogue_markdown(effects: Sequence[Effect], scans: Sequence[Family] = ()) -> str:
    """docs/effects.md: generated, so that it cannot go stale."""
    lines = [
        "# The catalogue of effects",
        "",
        "Generated from the code by `make docs`. Effects act on the truth: reading = x + Σ sensor",
        "effects(x), x = mounting(fixture(truth)). Fixture effects belong to the bench, not the "
        "tool. Every calibrator searches those whose needs its data meet; rate ω, spin dω/dt and",
        "jerk are the motion of an array, whose parameters are those of one IMU, or of all. A size",
        "beyond the largest believable one names no cause: what comes out so is not taken.",
        "",
    ]
    for effect in effects:
        sizes = "; ".join(
            f"`{p.name}` typical {p.typical:g} (at most {p.plausible:g}) {p.unit}"
            for p in _parameters(effect)
        )
        lines += [
            f"## {effect.name}",
            "",
            f"{effect.sentence} Acts on: {_acts_on(effect)}.",
            "",
            f"- Equation: `{effect.equation}`",
            f"- Parameters: {sizes}",
            f"- Needs: {', '.join(effect.needs) or 'nothing beside the readings'}",
            f"- Source: {effect.source}",
            f"- To identify it: {effect.identify}",
            "",
        ]
    if scans:
        lines += ["## With a value that the search finds", "", "| for example | what it is |"]
        lines += ["|---|---|"]
        lines += [f"| {_shown(family)} | {family.sentence} |" for family in scans]
        lines += [""]
    return "\n".join(lines)


def _shown(family: Family) -> str:
    return f"`{family.name}@{family.example}`: `{family.member(family.example).equation}`"
