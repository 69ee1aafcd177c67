"""The closed loop as report sections: the same for every calibrator."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucalib.calibration.findings import Findings, FoundStep, Gain
from imucalib.calibration.outcome import ErrorSummary, Outcome
from imucalib.calibration.power import hidden
from imucalib.effects.shape import in_words
from imucalib.loop.found import Score
from imucalib.report.document import Block, Facts, Plot, Section, Series, Table, Text, Tone
from imucalib.significant_digits import per_cent, plus_minus
from imucalib.units import MG


def step_tables(found: Findings) -> list[Table]:
    """Effects that were added; a column of sizes and of nats held out where a calibrator has it."""
    kinds = dict.fromkeys(tuple(c.metric for c in s.checks) for s in found.steps)
    return [
        _table([s for s in found.steps if tuple(c.metric for c in s.checks) == kind], found)
        for kind in kinds
    ]


def _table(steps: Sequence[FoundStep], found: Findings) -> Table:
    checks = steps[0].checks
    sized, nats = (any(getattr(s, name) for s in steps) for name in ("size", "held_out"))
    rows = tuple(
        (
            s.effect,
            *((s.size,) if sized else ()),
            per_cent(s.probability),
            *((f"{s.evidence:.1f}", ", ".join(f"{v:.0f}" for v in s.held_out)) if nats else ()),
            *_changes(s),
            _others(s) or ("nothing: certain" if s.certain else "-"),
        )
        for s in steps
    )
    errors = (
        ("before", "after") if len(checks) == 1 else tuple(f"{c.metric}, {c.unit}" for c in checks)
    )
    header = (
        "effect added",
        *(("size",) if sized else ()),
        "there",
        *(("nats", "held out, nats") if nats else ()),
        *errors,
        "cannot be told from",
    )
    align = "l" + "l" * sized + "r" * (len(header) - 2 - sized) + "l"
    if len(checks) == 1:
        note = f"{_upper(checks[0].metric).removesuffix(', rms')} in {checks[0].unit} rms, "
        note += "of all steps together. There: how likely it is, in this place or beside another."
    else:
        note = (
            "There: how likely it is. Held out: what each half of the data gains by "
            "the effect as the other half has it. Residuals: median absolute deviation, held out."
        )
    return Table("Steps of the loop", header, rows, align, note)


def _others(step: FoundStep) -> str:
    """What may stand in a step's place, with its share where there is one."""
    if not step.rivals:
        return ", ".join(step.aliases)
    return ", ".join(f"{n} {per_cent(s)}" for n, s in step.rivals if n != step.effect)


def _changes(step: FoundStep) -> tuple[str, ...]:
    if len(step.checks) == 1:
        (check,) = step.checks
        return f"{check.before:.{check.digits}f}", f"{check.after:.{check.digits}f}"
    return tuple(f"{c.before:.{c.digits}f} -> {c.after:.{c.digits}f}" for c in step.checks)


def _upper(text: str) -> str:
    return text[0].upper() + text[1:]


def gain_plot(found: Findings | None) -> tuple[Plot, ...]:
    """One plot where held-out data say what a step is worth; empty where they do not."""
    gain = found.gain if found else None
    if gain is None:
        return ()
    known = np.full(2, np.nan)
    bars = Series(
        "held out", np.arange(3.0), np.array([gain.before, gain.after, gain.before - gain.after]),
        "bars", np.append(known, gain.low), np.append(known, gain.high),
        names=("before", "after", "gain, 95 %"),
    )  # fmt: skip
    words = "excludes" if gain.low > 0.0 else "includes"
    caption = f"On data that took no part in any choice. The interval of the gain {words} zero"
    caption += "." if math.isnan(gain.nats) else f"; {density_words(gain)}."
    return (Plot("What the search is worth", "", f"error ({gain.unit})", (bars,), caption),)


def density_words(gain: Gain) -> str:
    """What the log density of held-out data gains, where it was judged."""
    return f"in log density {gain.nats:+.1f} nats, at least {gain.nats_low:+.1f}"


#: Probability from which on something that is not told is likely enough to be named, and how many.
_LIKELY, _NAMED = 0.1, 2


def likeliest_words(found: Findings) -> str:
    """What nothing missing may turn out to be, with the probability of each, or nothing."""
    likely = [s for s in found.scores if s.probability > _LIKELY][:_NAMED]
    words = ", ".join(f"{in_words(s.name)} {per_cent(s.probability)}" for s in likely)
    return f"; the likeliest that could be: {words}" if words else ""


def refuted_words(found: Findings) -> str:
    """Why nothing was taken where nothing is left."""
    if not found.refuted or found.gain is None:
        return "no candidate passes the search"
    g, names = found.gain, " and ".join(map(in_words, found.refuted))
    return (
        f"{names} stood out by more than chance, but not on data that took no part "
        f"({g.before:.3g} {g.unit} without, {g.after:.3g} with)"
    )


TERMS: tuple[tuple[str, str], ...] = (
    ("mg", "a thousandth of standard gravity, 0.00980665 m/s²"),
    ("|a|", "the size of the measured acceleration; at rest it is local gravity"),
    ("raw, base, final", "the reading as it came; corrected by the usual parameters; corrected by "
     "these and by what the search found"),
    ("held out", "on data that took no part: searched and fitted without them, then predicted"),
    ("noise floor", "what noise alone would leave, from positions that repeat or as declared"),
    ("sd, ±", "one standard deviation; 95 %: an interval that holds the truth 19 times of 20"),
    ("p", "the chance that the best of all candidates does as well on data that lack nothing"),
    ("nats", "evidence: e to that power is how much more probable the data are with the effect"),
    ("explained, suspected", "the gain on held-out data excludes zero, or does not yet"),
    ("cannot be told from", "effects that do the same to these data; a name stays open, the "
     "correction averages over them"),
    ("left (%), λ", "share of an effect that the fitted parameters do not take up, and its "
     "strength over the noise: about 4.7 is found four times of five"),
    ("bias, scale, cross", "reading at zero; sensitivity minus one; what one axis reads of "
     "another's acceleration (non-orthogonality)"),
    ("posture run", "a stretch at rest in one posture, taken as one observation"),
    ("tool-face, inclination", "roll about the tool's axis, and its angle from the horizontal"),
)  # fmt: skip

_HELD_OUT = {
    "actigraph": "Held out: each block of time predicted by a fit without it.",
    "array": "Held out: each half of the motion, in blocks, under what a search of the other half "
    "finds; ω, dω/dt and s are every sample's own. MAD: median absolute deviation.",
    "": "Held out: each position predicted by a fit without it, or the test rows.",
}
#: Effects that could hide, as many as are told.
_WEAK = 3
_ANEW = (
    "Held out: a part at a time, predicted by a model that was searched for and fitted without "
    "it, or the test rows."
)


def floor_words(error: ErrorSummary, digits: int = 2) -> str:
    """What the measured noise alone would leave, in brackets."""
    if math.isnan(error.floor):
        return "(noise floor unknown: nothing repeated, no noise declared)"
    return f"(noise floor {error.floor:.{digits}f})"


def error_table(error: ErrorSummary, note: str = "") -> Table:
    """Error before and after, fitted and on data that was not fitted, with the floor."""
    digits = 3 if error.unit == "m/s²" else 2

    def number(value: float) -> str:
        return "-" if math.isnan(value) else f"{value:.{digits}f}"  # there was no held-out part

    held, fitted = error.held_out, not (math.isnan(error.base) and math.isnan(error.final))
    rows = (
        ("raw reading", error.raw, held.raw),
        ("base model", error.base, held.base),
        ("final model", error.final, held.final),
    )
    known = "unknown" if math.isnan(error.floor) else number(error.floor)
    floor = ("noise floor", known, *(("",) if fitted else ()))
    shown = tuple(
        (name, *((number(f),) if fitted else ()), number(h))
        for name, f, h in rows
        if fitted or not math.isnan(h)
    )
    header = ("", "fitted", "held out") if fitted else ("", "held out")
    title = f"Error before and after ({error.metric}, {error.unit})"
    return Table(title, header, (*shown, floor), "l" + "r" * (len(header) - 1), note)


def loop_section(outcome: Outcome) -> Section:
    """What was found, step by step, and what stays."""
    found = outcome.findings
    note = _HELD_OUT.get(outcome.calibrator, _HELD_OUT[""])
    if found and found.steps and outcome.calibrator != "array":
        note = _ANEW
    known = [e for e in outcome.errors if not (math.isnan(e.base) and math.isnan(e.held_out.base))]
    shown = [error_table(e, note if e is known[-1] else "") for e in known]
    if found is None:
        return Section("Closed loop", (Text("The search was not run."), *shown))
    blocks: list[Block] = [*_records(found), _verdict(found)]
    if any(size for _, size in found.declared):
        blocks.append(Table("Declared effects", ("effect", "size"), found.declared, "ll"))
    limits = [
        f"{words} {', '.join(names)}"
        for words, names in (("only", found.only), ("without", found.without)) if names
    ]  # fmt: skip
    if limits:
        blocks.append(Text(f"The search was limited: {'; '.join(limits)}."))
    blocks += step_tables(found)
    blocks += _power(found)
    blocks += shown
    if found.facts:
        blocks.append(Facts(found.facts))
    return Section("Closed loop", tuple(blocks))


def _power(found: Findings) -> list[Text]:
    """What may be there unseen, and how large."""
    every = hidden(found.scores, [s.effect for s in found.steps])
    absorbed = [f"{h.name} ({h.size / MG:.2g} mg)" for h in every if h.absorbed]
    weak = [f"{h.name} {h.size / MG:.2g} mg" for h in every if not h.absorbed][:_WEAK]
    said = []
    if absorbed:
        text = "These data cannot show, whatever the size (rms at a typical one): "
        said.append(Text(f"{text}{', '.join(absorbed)}.", "warning"))
    if weak:
        text = "What could hide, rms on a reading that four of five recordings would show: up to "
        said.append(Text(f"{text}{', '.join(weak)}."))
    return said


def _records(found: Findings) -> list[Table]:
    if not found.records:
        return []
    rows = tuple(
        (r.where, r.channel, plus_minus(r.size, r.sd, r.unit), per_cent(r.probability), r.likely)
        for r in found.records
    )
    header = ("record", "channel", "off by", "p", "likely")
    tones: dict[int, Tone] = dict.fromkeys(range(len(rows)), "bad")
    return [Table("Records that do not belong to the rest", header, rows, "lllll", tones=tones)]


def _verdict(found: Findings) -> Text:
    named = [s for s in found.steps if not s.curve]
    names = ", ".join(
        f"a form without a known cause ({s.formula})"
        if s.formula
        else " or ".join(map(in_words, (s.effect, *s.aliases)))
        for s in named
    )
    records = ", ".join(r.where for r in found.records)
    cause = " and ".join(
        part for part in (f"a wrong record ({records})" if records else "", names) if part
    )
    parts = [f"{u.name} (driven by {u.driver})" if u.driver else u.name for u in found.unexplained]
    parts += [f"{s.curve}, corrected by a curve" for s in found.steps if s.curve]
    unknown = ", ".join(parts)
    aside = f", {records} set aside" if records else ""
    gained = f" Held out{aside}: {found.gain.words}." if found.gain and found.steps else ""
    return {
        "not run": Text("Fitted with the declared effects; the search was not run."),
        "nothing missing": Text(f"Nothing is missing: {refuted_words(found)}.", "ok"),
        "explained": Text(f"The residual is explained by {cause}.{gained}", "ok"),
        "explained in part": Text(
            f"The residual is explained in part by {cause}; left: {unknown}.{gained}", "warning"
        ),
        "suspected": Text(
            f"Suspected: {cause}. {_unproved(named)}{f'; left: {unknown}' if unknown else ''}"
            f".{gained}",
            "warning",
        ),
        "unexplained": Text(
            f"Unexplained structure: {unknown}. No effect that was searched fits.", "bad"
        ),
    }[found.verdict]


def _unproved(named: Sequence[FoundStep]) -> str:
    if named:
        return "The correction is applied, but held-out data do not prove it yet"
    return "One clean table in a hundred has such a record: read it again before it is left out"


def candidate_rows(scores: Sequence[Score]) -> list[tuple[str, ...]]:
    """Name, kind, evidence, p, share left, strength and size (mg) of every candidate."""
    return [
        (
            s.name,
            s.kind,
            "absorbed" if s.absorbed else f"{s.evidence:.2f}",
            "-" if s.absorbed else per_cent(s.probability),
            f"{100.0 * s.left:.1f}",
            f"{s.strength:.1f}",
            f"{s.size / MG:.2g}" if s.size else "-",
        )
        for s in scores
    ]


def candidate_section(found: Findings) -> Section:
    """Every candidate of the last search with its numbers, why not, and what cannot be shown."""
    rejected = dict(found.rejected)
    # Of a scan only members that say something: it has hundreds.
    scores = [s for s in found.scores if "@" not in s.name or s.evidence > 1.0]
    rows = candidate_rows(scores)
    rows += [(name, "effect", "rejected", "-", "-", "-", "-") for name in rejected]
    rows += [(name, "effect", "not tested", "-", "-", "-", "-") for name in found.missing]
    header = ("candidate", "kind", "evidence (nats)", "there", "left (%)", "λ", "size (mg)")
    note = (
        "Last search, after everything above was added. Left: share of the effect that the fitted "
        "parameters do not absorb. λ: strength at typical size; about 4.7 gives an 80 % chance to "
        "find it. Size: what it does to a reading at typical size, rms; an absorbed effect cannot "
        "be tested on these data and shifts the answer by so much."
    )
    why = "; ".join(
        f"{name}: {reason}" for name, reason in (*rejected.items(), *found.missing.items())
    )
    blocks: list[Block] = [Table("All candidates", header, tuple(rows), "llrrrrr", note)]
    if why:
        blocks.append(Text(f"Rejected or not tested: {why}."))
    if found.not_testable:
        table = tuple((u.effect, u.typical, f"{u.shift:.2g} {u.unit}") for u in found.not_testable)
        blocks.append(
            Table("What these data cannot show", ("not testable", "at", "moves the answer by"),
                  table, "llr", "Absorbed by what is fitted, or by effects already in the model.")
        )  # fmt: skip
    return Section("Candidates tried", tuple(blocks), brief=False)


def advice_section(outcome: Outcome) -> Section:
    """What to do next."""
    lines = tuple(Text(sentence) for sentence in outcome.advice)
    return Section("Advice", lines or (Text("Nothing to do."),), brief=False)
