"""The reports of `imucal design`, as documents and as plain types: of positions, and of what to
record next to end an ambiguity (`--separate`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibrators.lab.design import Addition, Design, PositionPlan
from imucalib.calibrators.next_recording import AmbiguityPlan, NextRecording
from imucalib.data import fields, plain
from imucalib.posterior.odds import ENDED
from imucalib.report.render.document import Block, Document, Section, Table, Text, Tone
from imucalib.units import DEG


def compose_design_document(plan: PositionPlan, *, answer: bool = False) -> Document:
    """Efficiency, what stays open, the next positions, and the positions themselves.

    answer : the positions are the answer, not what was given
    """
    poor = plan.vector.open_directions or plan.norm.open_directions
    best = min(plan.vector.efficiency, plan.norm.efficiency)
    tone: Tone = "bad" if poor else "ok" if best > 0.7 else "warning"
    verdict = (
        f"{plan.vector.positions} positions: efficiency {plan.vector.efficiency:.2f} with known "
        f"angles, {plan.norm.efficiency:.2f} by |a| alone (1 is a uniform sphere)."
    )
    open_ = [
        Text(f"With {name} these stay open: {o}.", "bad")
        for name, design in _designs(plan)
        for o in design.open_directions
    ]
    setting = (
        f"In this order inclination is set {plan.settings[0]} times and tool-face "
        f"{plan.settings[1]} times; setting errors average over these, noise over all positions. "
        "Setting one position several times anew separates the two."
    )
    angles = zip(plan.inclination, plan.tool_face, strict=True)
    rows = tuple((str(k), f"{i:.1f}", f"{t:.1f}") for k, (i, t) in enumerate(angles, start=1))
    positions = Table("", ("row", "inclination", "tool-face"), rows, "rrr")
    own = Section("Positions", (positions,), kept=answer)
    quality = Section("Quality", (*open_, _parameters(plan), Text(setting)))
    more = Section("Positions to add", (_additions(plan),))
    order = (own, quality, more) if answer else (more, quality, own)
    return Document("Design of positions", Text(verdict, tone), order)


def _designs(plan: PositionPlan) -> tuple[tuple[str, Design], ...]:
    return ("known angles", plan.vector), ("|a| alone", plan.norm)


def _shown(plan: PositionPlan, addition: Addition) -> tuple[float, float]:
    """In the bench's own angles."""
    inner = (np.array([addition.inclination * DEG]), np.array([addition.tool_face * DEG]))
    inclination, tool_face = plan.conventions.outside(*inner)
    return float(inclination[0]), float(tool_face[0])


def _additions(plan: PositionPlan) -> Table:
    rows = []
    for name, design in _designs(plan):
        for k, addition in enumerate(design.additions, start=1):
            angles = (f"{v:.0f}" for v in _shown(plan, addition))
            gain = f"{addition.gain:.2f} x" if np.isfinite(addition.gain) else "decisive"
            last = (f"{addition.efficiency:.2f}", f"{gain} {addition.parameter}")
            rows.append((name, str(k), *angles, *last))
    header = ("reference", "add", "inclination", "tool-face", "efficiency", "best gain in sd")
    return Table("Best first", header, tuple(rows), "lrrrrl")


def _parameters(plan: PositionPlan) -> Table:
    by_norm = dict(zip(plan.norm.names, plan.norm.sd, strict=True))

    def number(value: float | None) -> str:
        if value is None:
            return "-"
        return f"{value:.2g}" if np.isfinite(value) else "open"

    known = zip(plan.vector.names, plan.vector.sd, plan.vector.units, strict=True)
    rows = tuple((n, number(float(s)), number(by_norm.get(n)), unit) for n, s, unit in known)
    header = ("parameter", "known angles", "|a| alone", "unit")
    return Table("Standard deviation for 1 mg of noise", header, rows, "lrrl")


def design_dict(plan: PositionPlan) -> dict[str, Any]:
    """Plain types, ready for JSON; infinite numbers become null."""
    angles = ("inclination", "tool_face")

    def one(design: Design) -> dict[str, Any]:
        return {
            "efficiency": design.efficiency,
            "condition": design.condition if design.condition < 1e15 else None,
            "open": design.open_directions,
            "sd_for_1_mg": dict(zip(design.names, design.sd, strict=True)),
            "add": [
                dict(zip(angles, _shown(plan, a), strict=True)) | fields(a, "efficiency parameter")
                for a in design.additions
            ],
        }

    positions = zip(plan.inclination, plan.tool_face, strict=True)
    content = {
        "schema": "imucal/design/1",
        "positions": [dict(zip(angles, map(float, p), strict=True)) for p in positions],
        "known_angles": one(plan.vector),
        "norm_only": one(plan.norm),
    }
    return dict(plain(content))


def compose_separation_document(found: NextRecording, name: str) -> Document:
    """What is ambiguous, what to record, and what that promises."""
    planned, title = sum(len(part.rows) for part in found.parts), f"Record this next: {name}"
    if not found.parts:
        words = (
            "Nothing is ambiguous: no effect of this calibration has a rival that its data cannot "
            "tell from it. There is nothing to separate."
        )
        return Document(title, Text(words, "ok"), ())
    words = f"{planned} {found.what} do not end the ambiguity whole."
    if found.exit_code == 0:
        words = f"{planned} {found.what} end what these data cannot tell apart."
    elif not planned:
        words = f"No {found.what} of this kind tell these apart; see what would."
    parts = tuple(
        Section(" or ".join(part.separation.rivals), tuple(_blocks(part, found)), kept=True)
        for part in found.parts
    )
    return Document(title, Text(words, "warning" if found.exit_code else "ok"), parts)


def _blocks(part: AmbiguityPlan, found: NextRecording) -> list[Block]:
    one, blocks = part.separation, list[Block]()
    for truth, other in one.never:
        words = (
            f"No number of {found.what} tells {truth} from {other}: {other} holds all that "
            f"{truth} does here."
        )
        blocks.append(Text(words, "warning"))
    if part.remedies:
        blocks.append(Text(f"What would: {'; '.join(part.remedies)}."))
    if not part.rows:
        return blocks
    ends = ", ".join(f"{100.0 * p:.0f} % if it is {name}" for name, p in one.ends.items())
    against = " against those that can be told from it" if one.never else ""
    short = ""
    if min(one.ends.values()) < ENDED:
        short = f" That is short of {100.0 * ENDED:.0f} %, with as many as a plan may have."
    blocks.append(Text(f"With them the name will be certain{against}: {ends}.{short}"))
    pairs = zip(one.pairs, one.now, one.then, strict=True)
    rows = tuple((*pair, f"{now:.1f}", f"{then:.1f}") for pair, now, then in pairs)
    note = "What of the truth its rival cannot take over, in units of the noise."
    blocks.append(Table("How far apart", ("truth", "rival", "now", "then"), rows, "llrr", note))
    title, align = f"Record these {found.what}", "r" * len(part.header)
    return [*blocks, Table(title, part.header, part.rows, align, _note(part, found))]


def _note(part: AmbiguityPlan, found: NextRecording) -> str:
    if found.what == "postures":
        return "Hold each still for a minute, within about 10 deg, in any order."
    words = "Set the dials as finely as before, each row anew."
    if part.header[1].startswith("gravity"):
        words = "Within about 5 deg; what counts is which axes share gravity."
    if found.between > 0.0:
        return f"{words} The plan allows for another power-up."
    return (
        f"{words} Append them to the table, recorded in the same power-up; where that is over, "
        "plan with --between-sessions."
    )


def separation_dict(found: NextRecording) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    ambiguities = []
    for part in found.parts:
        one = part.separation
        pairs = zip(one.pairs, one.now, one.then, strict=True)
        ambiguity = {
            **fields(one, "effect rivals ended=enough"),
            "certain_percent": {name: 100.0 * p for name, p in one.ends.items()},
            "apart": [
                {"truth": truth, "rival": other, "now": now, "then": then}
                for (truth, other), now, then in pairs
            ],
            "never": one.never,
            "what_would": part.remedies,
            found.what: [dict(zip(part.header[1:], r[1:], strict=True)) for r in part.rows],
        }
        ambiguities.append(ambiguity)
    content = {
        "schema": "imucal/separation/2",
        "calibrator": found.calibrator,
        "ended": found.exit_code == 0,
        "between_sessions_mg": found.between,
        "ambiguities": ambiguities,
        "table": found.table,
    }
    return dict(plain(content))
