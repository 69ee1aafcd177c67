"""The report of `imucal design --separate`."""

from __future__ import annotations

from typing import Any

from imucalib.calibration.plain import plain
from imucalib.calibrators.next_recording import NextRecording, Part
from imucalib.loop.separation import ENOUGH
from imucalib.report.document import Block, Document, Section, Table, Text


def separation_document(found: NextRecording, name: str) -> Document:
    """What is ambiguous, what to record, and what that promises."""
    if not found.parts:
        verdict = Text(
            "Nothing is ambiguous: no effect of this calibration has a rival that its data cannot "
            "tell from it. There is nothing to separate.",
            "ok",
        )
        return Document(f"Record this next: {name}", verdict, ())
    sections = tuple(
        Section(" or ".join(part.separation.rivals), tuple(_blocks(part, found)), kept=True)
        for part in found.parts
    )
    return Document(f"Record this next: {name}", _verdict(found), sections)


def _verdict(found: NextRecording) -> Text:
    planned = sum(len(part.rows) for part in found.parts)
    if found.exit_code == 0:
        return Text(f"{planned} {found.what} end what these data cannot tell apart.", "ok")
    if not planned:
        return Text(f"No {found.what} of this kind tell these apart; see what would.", "warning")
    return Text(f"{planned} {found.what} do not end the ambiguity whole.", "warning")


def _blocks(part: Part, found: NextRecording) -> list[Block]:
    one = part.separation
    blocks: list[Block] = []
    for truth, other in one.never:
        words = (
            f"No number of {found.what} tells {truth} from {other}: {other} holds all that "
            f"{truth} does here."
        )
        blocks.append(Text(words, "warning"))
    if part.remedies:
        blocks.append(Text(f"What would: {'; '.join(part.remedies)}."))
    if part.rows:
        blocks += [Text(_promise(part)), _pairs(part)]
        align = "r" * len(part.header)
        title = f"Record these {found.what}"
        blocks.append(Table(title, part.header, part.rows, align, _note(part, found)))
    return blocks


def _promise(part: Part) -> str:
    ends = [f"{100.0 * p:.0f} % if it is {name}" for name, p in part.separation.ends.items()]
    against = " against those that can be told from it" if part.separation.never else ""
    short = ""
    if min(part.separation.ends.values()) < ENOUGH:
        short = f" That is short of {100.0 * ENOUGH:.0f} %, with as many as a plan may have."
    return f"With them the name will be certain{against}: {', '.join(ends)}.{short}"


def _pairs(part: Part) -> Table:
    one = part.separation
    rows = tuple(
        (truth, other, f"{now:.1f}", f"{then:.1f}")
        for (truth, other), now, then in zip(one.pairs, one.now, one.then, strict=True)
    )
    note = "What of the truth its rival cannot take over, in units of the noise."
    return Table("How far apart", ("truth", "rival", "now", "then"), rows, "llrr", note)


def _note(part: Part, found: NextRecording) -> str:
    if found.what == "postures":
        return "Hold each still for a minute, within about 10 deg, in any order."
    words = (
        "Within about 5 deg; what counts is which axes share gravity."
        if part.header[1].startswith("gravity")
        else "Set the dials as finely as before, each row anew."
    )
    if found.wish.between > 0.0:
        return words + " The plan allows for another power-up."
    return words + (
        " Append them to the table, recorded in the same power-up; where that is over, plan with "
        "--between-sessions."
    )


def separation_dict(found: NextRecording) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    content: dict[str, Any] = plain(
        {
            "schema": "imucal/separation/2",
            "calibrator": found.calibrator,
            "ended": found.exit_code == 0,
            "between_sessions_mg": found.wish.between,
            "ambiguities": [_part_dict(part, found.what) for part in found.parts],
            "table": found.table,
        }
    )
    return content


def _part_dict(part: Part, what: str) -> dict[str, Any]:
    one = part.separation
    return {
        "effect": one.effect,
        "rivals": list(one.rivals),
        "ended": one.enough,
        "certain_percent": {name: 100.0 * p for name, p in one.ends.items()},
        "apart": [
            {"truth": truth, "rival": other, "now": float(now), "then": float(then)}
            for (truth, other), now, then in zip(one.pairs, one.now, one.then, strict=True)
        ],
        "never": [list(pair) for pair in one.never],
        "what_would": list(part.remedies),
        what: [dict(zip(part.header[1:], row[1:], strict=True)) for row in part.rows],
    }
