"""The report of `imucal design --separate`."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.plain import plain
from imucalib.calibrators.array.separate.menu import SECONDS
from imucalib.calibrators.separate.next_recording import NextRecording, Part
from imucalib.loop.separation.plan import ENOUGH, Beside
from imucalib.loop.thresholds import APART
from imucalib.report.document import Block, Document, Section, Table, Text


def separation_document(found: NextRecording, name: str) -> Document:
    """What is ambiguous, what to record, what that promises, and what other plans would need."""
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
    what = found.parts[0].what
    if what == "motion":
        if found.exit_code == 0:
            return Text("One motion ends what these data cannot tell apart.", "ok")
        return Text("No motion of the menu ends the ambiguity whole.", "warning")
    if found.exit_code == 0:
        return Text(f"{planned} {what} end what these data cannot tell apart.", "ok")
    if not planned:
        return Text(f"No {what} of this kind tell these apart; see what would.", "warning")
    return Text(f"{planned} {what} do not end the ambiguity whole.", "warning")


def _blocks(part: Part, found: NextRecording) -> list[Block]:
    one = part.separation
    blocks: list[Block] = []
    motion = part.what == "motion"
    any_number = "No motion" if motion else f"No number of {part.what}"
    for truth, other in one.never:
        words = (
            f"{any_number} tells {truth} from {other}: {other} holds all that {truth} does here."
        )
        blocks.append(Text(words, "warning"))
    if part.remedies:
        blocks.append(Text(f"What would: {'; '.join(part.remedies)}."))
    if not part.rows:
        return blocks
    blocks += [Text(_promise(part)), *_first_ones(part), _pairs(part)]
    title = "Record this motion" if motion else f"Record these {part.what}"
    align = "r" + ("l" if motion else "r") * (len(part.header) - 1)
    blocks.append(Table(title, part.header, part.rows, align, _note(part, found)))
    if one.informative and one.random:
        blocks.append(_beside(part, one.informative, one.random))
    return blocks


def _promise(part: Part) -> str:
    ended = [
        f"{100.0 * share:.0f} of 100 if it is {name}"
        for name, share in part.separation.ended.items()
    ]
    apart = " from those that can be told from it" if part.separation.never else ""
    short = "" if part.ended or part.separation.never else (
        f" That is short of {100.0 * ENOUGH:.0f}, with as many as a plan may have."
    )  # fmt: skip
    after = "After it" if part.what == "motion" else "After them"
    return f"{after} one name stands alone{apart} in {', '.join(ended)} (simulated).{short}"


def _first_ones(part: Part) -> list[Block]:
    """With how few of them to search again."""
    early = part.separation.soon
    if early is None:
        return []
    words = (
        f"Search again after the first {early.count}: in {100.0 * early.chance:.0f} of 100 they "
        "are enough, each name as likely as the recording makes it "
        f"({', '.join(f'{name} {share:.0%}' for name, share in early.likely.items())})."
    )
    return [Text(words.replace("%", " %"))]


def _pairs(part: Part) -> Table:
    one = part.separation
    rows = tuple(
        (truth, other, f"{now:.1f}", f"{then:.1f}")
        for (truth, other), now, then in zip(one.pairs, one.now, one.apart, strict=True)
        if other in one.rivals
    )
    note = (
        f"λ sin(angle): what of the truth its rival cannot take over, in units of the noise. Below "
        f"{APART:g} nothing tells them apart."
    )
    return Table("Expected λ sin(angle)", ("truth", "rival", "now", "then"), rows, "llrr", note)


def _note(part: Part, found: NextRecording) -> str:
    if part.what == "motion":
        return "Add it to the recording, the board held as before; axes are those of the board."
    if part.what == "postures":
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


def _beside(part: Part, informative: Beside, random: Beside) -> Table:
    motion = part.what == "motion"
    size = SECONDS if motion else 1.0
    count = f"{size * len(part.separation.plan):g}" + (" s" if motion else "")

    def needed(one: Beside) -> str:
        return f"{size * one.needed:g}" if one.needed else f"more than {size * one.followed:g}"

    rows = (
        ("this plan", f"{part.separation.least:.1f}", f"{size * len(part.separation.plan):g}"),
        ("best for the base model", f"{informative.apart:.1f}", needed(informative)),
        ("random", f"{random.apart:.1f}", needed(random)),
    )
    what = "seconds" if motion else part.what
    header = ("plan", f"λ sin(angle) of {count}", f"{what} for the same")
    return Table(f"Other plans of {count}" if motion else f"Other plans of {count} {what}",
                 header, rows, "lrr")  # fmt: skip


def separation_dict(found: NextRecording) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    content: dict[str, Any] = plain({
        "schema": "imucal/separation/1",
        "calibrator": found.calibrator,
        "ended": found.exit_code == 0,
        "between_sessions_mg": found.wish.between,
        "ambiguities": [_part_dict(part) for part in found.parts],
        "table": found.table,
    })  # fmt: skip
    return content


def _part_dict(part: Part) -> dict[str, Any]:
    one = part.separation
    return {
        "effect": one.effect,
        "rivals": list(one.rivals),
        "evidence_nats": dict(one.nats),
        "ended": part.ended,
        "ends_in_100": {name: 100.0 * share for name, share in one.ended.items()},
        "lambda_sin_angle": [
            {"truth": truth, "rival": other, "now": float(now), "then": float(then)}
            for (truth, other), now, then in zip(one.pairs, one.now, one.apart, strict=True)
        ],
        "first_that_may_do": None
        if one.soon is None
        else {
            "count": one.soon.count,
            "ends_in_100": 100.0 * one.soon.chance,
            "if_it_is": {name: 100.0 * share for name, share in one.soon.ended.items()},
            "likely_percent": {name: 100.0 * share for name, share in one.soon.likely.items()},
        },
        "never": [list(pair) for pair in one.never],
        "what_would": list(part.remedies),
        part.what: [dict(zip(part.header[1:], row[1:], strict=True)) for row in part.rows],
        "other_plans": {
            "best_for_the_base_model": _beside_dict(one.informative),
            "random": _beside_dict(one.random),
        },
    }


def _beside_dict(one: Beside | None) -> dict[str, Any] | None:
    if one is None or not np.isfinite(one.apart):
        return None
    return {"lambda_sin_angle": one.apart, "needed": one.needed, "followed": one.followed}
