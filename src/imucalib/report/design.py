"""The report of `imucal design`."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibrators.lab.design import Addition, Design, Plan
from imucalib.report.document import Block, Document, Section, Table, Text, Tone
from imucalib.units import DEG


def design_document(plan: Plan, *, asked: bool = False) -> Document:
    """Efficiency, what stays open, the next positions, and the positions themselves.

    asked : the positions are the answer, not what was given
    """
    poor = plan.vector.open_directions or plan.norm.open_directions
    best = min(plan.vector.efficiency, plan.norm.efficiency)
    tone: Tone = "bad" if poor else "ok" if best > 0.7 else "warning"
    verdict = Text(
        f"{plan.vector.positions} positions: efficiency {plan.vector.efficiency:.2f} with known "
        f"angles, {plan.norm.efficiency:.2f} by |a| alone (1 is a uniform sphere).",
        tone,
    )
    blocks: list[Block] = []
    for name, design in (("known angles", plan.vector), ("|a| alone", plan.norm)):
        blocks += [
            Text(f"With {name} these stay open: {o}.", "bad") for o in design.open_directions
        ]
    setting = Text(
        f"In this order inclination is set {plan.settings[0]} times and tool-face "
        f"{plan.settings[1]} times; setting errors average over these, noise over all positions. "
        "Setting one position several times anew separates the two."
    )
    rows = tuple(
        (str(k + 1), f"{i:.1f}", f"{t:.1f}")
        for k, (i, t) in enumerate(zip(plan.inclination, plan.tool_face, strict=True))
    )
    quality = Section("Quality", (*blocks, _parameters(plan), setting))
    positions = Table("", ("row", "inclination", "tool-face"), rows, "rrr")
    own = Section("Positions", (positions,), brief=asked, kept=asked)
    more = Section("Positions to add", (_additions(plan),))
    order = (own, quality, more) if asked else (more, quality, own)
    return Document("Design of positions", verdict, order)


def _shown(plan: Plan, addition: Addition) -> tuple[float, float]:
    i, t = plan.conventions.outside(
        np.array([addition.inclination * DEG]), np.array([addition.tool_face * DEG])
    )
    return float(i[0]), float(t[0])


def _additions(plan: Plan) -> Table:
    rows = []
    for name, design in (("known angles", plan.vector), ("|a| alone", plan.norm)):
        for k, addition in enumerate(design.additions, start=1):
            i, t = _shown(plan, addition)
            gain = f"{addition.gain:.2f} x" if np.isfinite(addition.gain) else "decisive"
            rows.append(
                (
                    name,
                    str(k),
                    f"{i:.0f}",
                    f"{t:.0f}",
                    f"{addition.efficiency:.2f}",
                    f"{gain} {addition.parameter}",
                )
            )
    header = ("reference", "add", "inclination", "tool-face", "efficiency", "best gain in sd")
    return Table("Best first", header, tuple(rows), "lrrrrl")


def _parameters(plan: Plan) -> Table:
    by_norm = dict(zip(plan.norm.names, plan.norm.sd, strict=True))

    def number(value: float | None) -> str:
        if value is None:
            return "-"
        return f"{value:.2g}" if np.isfinite(value) else "open"

    rows = tuple(
        (name, number(float(sd)), number(by_norm.get(name)), unit)
        for name, sd, unit in zip(plan.vector.names, plan.vector.sd, plan.vector.units, strict=True)
    )
    header = ("parameter", "known angles", "|a| alone", "unit")
    return Table("Standard deviation for 1 mg of noise", header, rows, "lrrl")


def design_dict(plan: Plan) -> dict[str, Any]:
    """Plain types, ready for JSON; infinite numbers become null."""

    def one(design: Design) -> dict[str, Any]:
        return {
            "efficiency": design.efficiency,
            "condition": design.condition if design.condition < 1e15 else None,
            "open": list(design.open_directions),
            "sd_for_1_mg": {
                n: float(s) if np.isfinite(s) else None
                for n, s in zip(design.names, design.sd, strict=True)
            },
            "add": [
                dict(zip(("inclination", "tool_face"), _shown(plan, a), strict=True))
                | {"efficiency": a.efficiency, "parameter": a.parameter}
                for a in design.additions
            ],
        }

    return {
        "schema": "imucal/design/1",
        "positions": [
            {"inclination": float(i), "tool_face": float(t)}
            for i, t in zip(plan.inclination, plan.tool_face, strict=True)
        ],
        "known_angles": one(plan.vector),
        "norm_only": one(plan.norm),
    }
