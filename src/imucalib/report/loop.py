"""The closed loop as report sections: the same for every calibrator."""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucalib.calibration.outcome import ErrorSummary, Outcome
from imucalib.loop.evidence import Score
from imucalib.loop.found import FitLoop
from imucalib.report.document import Block, Section, Table, Text, Tone
from imucalib.significant_digits import plus_minus, probability
from imucalib.units import MG

_HELD_OUT = {
    "actigraph": "Held out: each block of time predicted by a fit without it.",
    "": "Held out: each position predicted by a fit without it, or the test rows.",
}
_ANEW = (
    "Held out: a part at a time, predicted by a model that was searched for and fitted without "
    "it, or the test rows."
)


def error_table(error: ErrorSummary, calibrator: str = "", loop: FitLoop | None = None) -> Table:
    """Error before and after, fitted and on data that was not fitted, with the floor."""
    note = _HELD_OUT.get(calibrator, _HELD_OUT[""])

    def number(value: float) -> str:
        return "-" if math.isnan(value) else f"{value:.2f}"  # there was no held-out part

    rows = (
        ("raw reading", number(error.raw), number(error.held_out.raw)),
        ("base model", number(error.base), number(error.held_out.base)),
        ("final model", number(error.final), number(error.held_out.final)),
        ("noise floor", number(error.floor), ""),
    )
    return Table(
        f"Error before and after ({error.metric}, {error.unit})",
        ("", "fitted", "held out"),
        rows,
        "lrr",
        _ANEW if loop and loop.steps else note,
    )


def loop_section(outcome: Outcome) -> Section:
    """What was found, step by step, and what stays."""
    loop = outcome.loop
    blocks: list[Block] = []
    if loop is None:
        table = error_table(outcome.error, outcome.calibrator)
        return Section("Closed loop", (Text("The search was not run."), table))
    if loop.records:
        rows = tuple(
            (r.where, r.channel, plus_minus(r.size, r.sd, r.unit), probability(r.p, 299), r.likely)
            for r in loop.records
        )
        header = ("record", "channel", "off by", "p", "likely")
        tones: dict[int, Tone] = dict.fromkeys(range(len(rows)), "bad")
        blocks.append(
            Table("Records that do not belong to the rest", header, rows, "lllll", tones=tones)
        )
    blocks.append(_verdict(loop))
    blocks += _measured(loop)
    if loop.steps:
        unit = 1.0 if outcome.error.unit != "mg" else 9.80665e-3
        rows = tuple(
            (
                s.effect,
                probability(s.p, s.draws),
                f"{s.checked[0].before / unit:.2f}",
                f"{s.checked[0].after / unit:.2f}",
                ", ".join(s.aliases) or "-",
            )
            for s in loop.steps
        )
        header = ("effect added", "p", "before", "after", "cannot be told from")
        note = (
            f"Leave-one-out error in {outcome.error.unit} rms, which took part in the choice; p is "
            "the chance in the whole search."
        )
        blocks.append(Table("Steps of the loop", header, rows, "lrrrl", note))
    blocks.append(error_table(outcome.error, outcome.calibrator, loop))
    return Section("Closed loop", tuple(blocks))


def _verdict(loop: FitLoop) -> Text:
    names = ", ".join(" or ".join((s.effect, *s.aliases)).replace("_", " ") for s in loop.named)
    records = ", ".join(r.where for r in loop.records)
    cause = " and ".join(
        part for part in (f"a wrong record ({records})" if records else "", names) if part
    )
    parts = [f"{u.name} (driven by {u.driver})" if u.driver else u.name for u in loop.unexplained]
    for step in loop.curves:
        what, against = step.effect.removeprefix("curve@").split(":")[:2]
        parts.append(f"{what} against {against}, corrected by a curve".replace("_", "-"))
    unknown = ", ".join(parts)
    return {
        "nothing missing": Text("Nothing is missing: no candidate passes the search.", "ok"),
        "explained": Text(f"The residual is explained by {cause}.", "ok"),
        "suspected": Text(
            f"Suspected: {cause}. Data left out do not prove it: the error's difference may be "
            "zero.",
            "warning",
        ),
        "explained in part": Text(
            f"The residual is explained in part by {cause}; left: {unknown}.", "warning"
        ),
        "unexplained": Text(
            f"Unexplained structure: {unknown}. No effect of the catalogue fits.", "bad"
        ),
    }[loop.verdict]


def _measured(loop: FitLoop) -> list[Block]:
    """What the search gains where it has not looked, and the walk that the noise holds."""
    blocks: list[Block] = []
    mg, nats = loop.difference, loop.density
    if mg is not None and nats is not None:
        blocks.append(
            Text(
                f"The whole search without each block of time in turn: error {mg.before:.2f} -> "
                f"{mg.after:.2f} mg, a gain of {mg.gain:+.3f} mg (95 %: {mg.low:+.3f} to "
                f"{mg.high:+.3f}), in log density {nats.gain:+.3f} nats a posture run "
                f"({nats.low:+.3f} to {nats.high:+.3f}); {mg.parts} blocks."
            )
        )
    if loop.wander is not None and loop.wander.counts and not loop.unexplained:
        words = loop.wander.words
        blocks.append(
            Text(
                f"{words[0].upper()}{words[1:]}: noise, which no effect explains; all standard "
                "deviations include it."
            )
        )
    return blocks


def candidate_rows(scores: Sequence[Score]) -> list[tuple[str, ...]]:
    """Name, kind, evidence, p, share left and strength of every candidate."""
    return [
        (
            s.name,
            s.candidate.kind,
            "absorbed" if s.absorbed else f"{s.evidence:.2f}",
            "-" if s.absorbed else probability(s.p, s.draws),
            f"{100.0 * s.left:.1f}",
            f"{s.strength:.1f}",
        )
        for s in scores
    ]


def candidate_section(loop: FitLoop) -> Section:
    """Every candidate of the last search with its numbers, and why not."""
    rejected = dict(loop.rejected)
    sizes = [f"{s.size / MG:.2g}" if s.size else "-" for s in loop.scores]
    rows = [(*row, size) for row, size in zip(candidate_rows(loop.scores), sizes, strict=True)]
    rows += [(name, "effect", "rejected", "-", "-", "-", "-") for name in rejected]
    rows += [(name, "effect", "not tested", "-", "-", "-", "-") for name in loop.missing]
    header = ("candidate", "kind", "evidence (nats)", "p", "left (%)", "λ", "size (mg)")
    note = (
        "Last search, after everything above was added. Left: share of the effect that the fitted "
        "parameters do not absorb. λ: strength at typical size; about 4.7 gives an 80 % chance to "
        "find it. Size: what it does to a reading at typical size, rms; an absorbed effect cannot "
        "be tested on these data and shifts the answer by so much."
    )
    why = "; ".join(
        f"{name}: {reason}" for name, reason in (*rejected.items(), *loop.missing.items())
    )
    blocks: tuple[Block, ...] = (Table("All candidates", header, tuple(rows), "llrrrrr", note),)
    if why:
        blocks = (*blocks, Text(f"Rejected or not tested: {why}."))
    return Section("Candidates tried", blocks, brief=False)


def advice_section(outcome: Outcome) -> Section:
    """What to do next."""
    lines = tuple(Text(sentence) for sentence in outcome.advice)
    return Section("Advice", lines or (Text("Nothing to do."),))
