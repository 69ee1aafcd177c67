"""The catalogue of effects as a document, as JSON and as the page of the documentation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucalib.core.array_motion import ArrayEffect
from imucalib.core.context import Context
from imucalib.core.effect import Effect
from imucalib.core.parameter import Parameter
from imucalib.report.document import Document, Facts, Section, Table, Text

Entry = Effect | ArrayEffect


def _parameters(effect: Entry) -> tuple[Parameter, ...]:
    """Those of one sensor; an array effect has them once, or once for each IMU."""
    if isinstance(effect, ArrayEffect):
        return effect.each
    return effect.parameters(Context(2, sweeps=2))


def _stage(effect: Entry) -> str:
    if isinstance(effect, ArrayEffect):
        sensors = {"accelerometer": "accelerometers", "gyroscope": "gyros"}[effect.sensor]
        return f"array: {'all ' if effect.shared else ''}{sensors}"
    return effect.stage


def _needs(effect: Entry) -> tuple[str, ...]:
    if isinstance(effect, ArrayEffect):
        return ("beat line",) if effect.needs_age else ()
    return tuple(effect.needs)


def effect_dict(effect: Entry) -> dict[str, Any]:
    """One effect as plain types."""
    return {
        "name": effect.name,
        "stage": _stage(effect),
        "sentence": effect.sentence,
        "equation": effect.equation,
        "source": effect.source,
        "needs": list(_needs(effect)),
        "identify": effect.identify,
        "parameters": [
            {"name": p.name, "unit": p.unit, "typical": p.typical, "plausible": p.plausible}
            for p in _parameters(effect)
        ],
    }


def catalogue_document(effects: Sequence[Entry]) -> Document:
    """A table of many effects, or everything about one."""
    if len(effects) == 1:
        return Document(effects[0].name, Text(effects[0].sentence), (_one(effects[0]),))
    tables = []
    for title, own in (
        ("Catalogue", [e for e in effects if not isinstance(e, ArrayEffect)]),
        ("Effects of an array", [e for e in effects if isinstance(e, ArrayEffect)]),
    ):
        rows = tuple(
            (e.name, _stage(e).removeprefix("array: "), _needed(e), _sizes(e)) for e in own
        )
        if rows:
            tables.append(
                Table(title, ("effect", "acts on", "needs", "typical size"), rows, "llll")
            )
    note = Text(
        "`imucal effects NAME` shows the equation, the source and how to record data for it."
    )
    verdict = Text(
        f"{len(effects)} effects. Fixture effects belong to the bench and are never applied; "
        "`imucal array` searches those of an array."
    )
    return Document("Effects", verdict, (Section("Catalogue", (*tables, note)),))


def _needed(effect: Entry) -> str:
    return ", ".join(_needs(effect)).replace("_", " ") or "-"


def _sizes(effect: Entry) -> str:
    return ", ".join(dict.fromkeys(f"{p.typical:g} {p.unit}" for p in _parameters(effect)))


def _one(effect: Entry) -> Section:
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
                    ("acts on", _stage(effect)),
                    ("needs", ", ".join(_needs(effect)) or "nothing beside the readings"),
                    ("source", effect.source),
                    ("to identify it", effect.identify),
                )
            ),
            Table("Parameters", header, rows, "lrrl"),
        ),
    )


def catalogue_markdown(effects: Sequence[Entry]) -> str:
    """docs/effects.md: generated, so that it cannot go stale."""
    lines = [
        "# The catalogue of effects",
        "",
        "Generated from the code by `make docs`. Effects act on the truth: reading = x + Σ sensor",
        "effects(x), x = mounting(fixture(truth)). Fixture effects belong to the bench, not the "
        "tool. Effects of an array (`imucal array`) stand at the end and act on the fitted motion:",
        "rate ω, dω/dt, specific force a of each IMU. Parameters are those of one IMU, or of all.",
        "",
    ]
    for effect in effects:
        sizes = "; ".join(f"`{p.name}` typical {p.typical:g} {p.unit}" for p in _parameters(effect))
        lines += [
            f"## {effect.name}",
            "",
            f"{effect.sentence} Acts on: {_stage(effect)}.",
            "",
            f"- Equation: `{effect.equation}`",
            f"- Parameters: {sizes}",
            f"- Needs: {', '.join(_needs(effect)) or 'nothing beside the readings'}",
            f"- Source: {effect.source}",
            f"- To identify it: {effect.identify}",
            "",
        ]
    return "\n".join(lines)
