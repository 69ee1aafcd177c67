"""What the report of every calibrator has: card, closed loop, candidates, parameters, linear part.

The card says what the result is worth, what was found, and what to do next.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.findings import Findings, find_hidden
from imucalib.calibration.outcome import NO_NAME, UNPROVED_NAME, ErrorSummary, Outcome, Run, Status
from imucalib.calibrators.population import Population
from imucalib.core.fit import Fit
from imucalib.effects import known, names_a_cause
from imucalib.effects.forms import in_words
from imucalib.exports import carries
from imucalib.posterior.closed_loop.found import Step, Unexplained
from imucalib.question import Question, paste
from imucalib.report.certificate import certify
from imucalib.report.render.document import (
    RESIDUALS,
    Block,
    Card,
    Column,
    Document,
    Facts,
    Plot,
    Section,
    Table,
    Text,
    Tone,
    Use,
    Worth,
    capital,
)
from imucalib.significant_digits import (
    format_components,
    format_with_sd,
    number,
    per_cent,
    plus_minus,
    probability,
    size_with_unit,
    two_digits,
)
from imucalib.units import MG

#: Parameters of one effect that a card names, names still open.
_PARAMETERS, _OPEN = 3, 3
#: Parameters of one effect up to which a table has them.
_MOST_ROWS = 12
#: Effects up to which a card says what each means, and rivals that it names of each.
_FEW, _RIVALS = 3, 3
#: Effects that could hide, as many as are named.
_WEAK = 3
#: From this probability on something that was not found is likely enough to be named; how many.
_LIKELY, _NAMED = 0.1, 2
#: Probability from which on "nothing is missing" has a tick.
_EVEN = 0.5
#: How reasons begin that the card says in full.
_IN_FULL = ("unexplained structure", "structure that no effect")
_CANDIDATES: tuple[Column, ...] = (
    ("candidate", "name", ""),
    ("kind", "kind", ""),
    ("evidence (nats)", lambda s: "absorbed" if s.absorbed else f"{s.evidence_nats:.2f}", ">"),
    ("P(present)", lambda s: None if s.absorbed else per_cent(s.probability), ">"),
    ("identifiable (%)", lambda s: 100.0 * s.left, ".1f"),
    ("λ", "lambda_at_typical_size", ".1f"),
    ("size (mg)", lambda s: s.size_m_per_s2 / MG or None, ".2g"),
)
_TONE: dict[Status, Tone] = {"ok": "ok", "marginal": "warning", "weak": "warning", "failed": "bad"}
_HELD_OUT = {
    "actigraph": "Held out: each block of time predicted by a fit without it.",
    "array": "Held out: each half of the motion, in blocks, under what a search of the other half "
    "finds; ω, dω/dt and s are every sample's own. MAD: median absolute deviation.",
    "": "Held out: each position predicted by a fit without it, or the test rows.",
}
_ANEW = (
    "Held out: a part at a time, predicted by a model that was searched for and fitted without "
    "it, or the test rows."
)
#: Corrects what was calibrated.
CORRECT = Use(
    "Correct the recording",
    ("apply", "{calibration}", "{input}", "-o", "{folder}/corrected{suffix}"),
)


def compose_calibration_document(
    title: str,
    run: Run,
    card: Card,
    *,
    first: Sequence[Section] = (),
    residuals: Sequence[Plot] = (),
    rest: Sequence[Section] = (),
) -> Document:
    """The report of a calibration, with its certificate and its provenance.

    first : sections ahead of those of the search; residuals : before and after it
    rest : sections behind them
    """
    outcome = run.outcome
    parts = [*first, _compose_loop_section(outcome), Section(RESIDUALS, tuple(residuals)), *rest]
    parts += [_compose_candidate_section(outcome.findings)] if outcome.findings else []
    parts.append(Section("Notes", Text.paragraphs(outcome.notes)))
    footer, verdict = outcome.provenance.footer, _verdict(outcome)
    return Document(title, verdict, tuple(parts), footer, card, certify(run, card))


def compose_card(
    outcome: Outcome,
    good_to: Sequence[Worth],
    *more: str,
    uses: tuple[Use, ...] = (),
    picture: Plot | None = None,
) -> Card:
    """The card of a run.

    good_to : what the calibrator can promise; more : advice of the calibrator's own, given last
    uses : commands that take what was written; picture : see `Card`
    """
    found, slips = outcome.findings or Findings("not run"), _slips(outcome)
    said = [Text(f"{capital(one.what)}.", "bad") for one in slips]
    # What a fit that did not settle finds, and what it is good to, mean nothing.
    settled = outcome.fit is None or outcome.fit.converged
    told = settled and found.verdict != "not run"
    said += _list_findings(found) if told or not slips else ()
    # Until slips are decided the other advice is about an error that is none of the sensor's.
    broken = (f"{text}." for text in outcome.broken)
    steps: tuple[str | Question, ...] = slips or (*broken, *outcome.advice, *more)
    command = outcome.provenance.command
    usable = outcome.status in ("ok", "marginal") and not outcome.undecided
    usable = usable and not outcome.corrected
    if outcome.corrected:
        steps = ("Calibrate the recording from which it was made.", *steps)
    return Card(
        tuple(good_to) if settled else (),
        tuple(said),
        tuple(decision(step, command) for step in steps),
        command,
        uses=uses if usable else (),
        picture=picture,
    )


def propose_export(calibration: Calibration, purpose: str, form: str, file: str) -> tuple[Use, ...]:
    """The command that writes a form, where that carries the calibration."""
    if not carries(calibration, form):
        return ()
    words = ("export", "{calibration}", "--to", form, "-o", f"{{folder}}/{file}")
    return (Use(purpose, words),)


def decision(step: str | Question, command: str) -> str:
    """What only the user can decide, as the command that does it; other advice as it is.

    command : that was typed, for a shell, or nothing
    """
    if isinstance(step, str):
        return step
    if not (step.options and command):
        return f"{capital(str(step))}."
    other = f"; else {step.otherwise}" if step.otherwise else ""
    named = capital(step.what.partition(":")[0])
    typed = f"{command} {paste(*step.options)}"
    return f"{named}: if that is right, type this{other}: `{typed}`"


def _verdict(outcome: Outcome) -> Text:
    """In words, without figures: these are on the card."""
    words = " ".join(f"{capital(text)}." for text in _why(outcome)) or "Ready to use."
    if outcome.broken:
        words = f"{'; '.join(outcome.broken)}."
    elif outcome.undecided:
        words = "Settle what is marked below before these figures are used."
    return Text(words, _TONE[outcome.status])


def _slips(outcome: Outcome) -> tuple[Question, ...]:
    """What only the user can decide, but for the wrong records that the search has named."""
    named = tuple(f"{r.where}:" for r in outcome.findings.records) if outcome.findings else ()
    return tuple(one for one in outcome.undecided if not one.what.startswith(named or ("\0",)))


def error_worth(
    error: ErrorSummary, quantity: str, of: str = "data", like: tuple[str, float] | None = None
) -> Worth:
    """A held-out error as worth, with what it was before; the fitted one where none was held out.

    of : what was held out, for example "positions"; like : data that are held out are of the same
    attitudes as the rest: of what, and the share of the sphere that is close to one of them
    """
    held = error.held_out
    # People read accelerations in mg.
    unit, size = ("mg", MG) if error.unit == "m/s²" else (error.unit, 1.0)
    final, base, raw = (two_digits(v / size) for v in (held.final, held.base, held.raw))
    how = error.metric.rpartition(", ")[2].replace("MAD", "median deviation")
    if math.isnan(held.final):
        fitted = f"{two_digits(error.final / size)} {unit}"
        return Worth(quantity, fitted, f"{how}, fitted; nothing was held out")
    before = [] if math.isnan(held.raw) else [f"raw {raw}"]
    before += [f"before the search {base}"] * (not math.isnan(held.base) and base != final)
    detail = f"{how} on {of} held out; {', '.join(before)}".rstrip("; ")
    more = f"for {like[0]} like these, {100.0 * like[1]:.0f} % of all directions" if like else ""
    return Worth(quantity, f"{final} {unit}", detail, more)


def gravity_worth(gravity: float) -> Worth:
    """What every size above is a multiple of (m/s²), where the place's was not given: on Earth it
    is 9.780 to 9.832 (GRS 80, Moritz 2000)."""
    detail = "assumed; a place's differs by up to 2.7 mg: --latitude"
    return Worth("gravity", f"{gravity:.6g} m/s²", detail)


def worst_attitude(quantity: str, sd: Array, directions: Array, what: str = "") -> Worth:
    """Of a 95 % interval, with gravity along some directions (n, 3).

    sd : (n,) mg; what : else the interval holds, in words
    """
    k = int(np.argmax(sd))
    along = np.round(directions[k], 1) + 0.0  # no minus before a zero
    towards = ", ".join(f"{a} {v:+.1f}" for a, v in zip("xyz", along, strict=True))
    detail = f"95 %; {two_digits(1.96 * sd.mean())} mg on average"
    where = f"{what}with gravity along {towards}"
    return Worth(f"{quantity}, worst attitude", f"± {two_digits(1.96 * sd[k])} mg", detail, where)


def _list_findings(found: Findings) -> list[Text]:
    """In the order in which a reader must know it."""
    tones: dict[str, Tone] = {"explained": "ok", "suspected": "warning"}
    lines = []
    for r in found.records:
        off = f"{capital(r.where)}: {r.channel} is {plus_minus(r.size, r.sd, r.unit)} off"
        lines.append(Text(f"{off} ({r.likely}, {per_cent(r.probability)}).", "bad"))
    for step in found.steps:
        effect, meaning = known(step.effect), ""
        # Of the bench's own effects the steps to take say what they are.
        if effect and effect.stage != "fixture" and not (step.curve or step.formula):
            meaning = f" {effect.sentence}" if len(found.steps) <= _FEW else ""
        said = f"{_describe_step(step)}{_doubt(step, found)}.{meaning}"
        lines.append(Text(said, tones.get(found.verdict, "plain")))
    if (g := found.gain) is not None and (found.steps or found.refuted):
        aside = ", the wrong records set aside," if found.records else ""
        gain, low, high = map(two_digits, (g.before - g.after, g.low, g.high))
        gained = f"gain {gain}, 95 % {low} to {high}{g.dense}"
        words = f"On held-out data{aside} {g.before:.3g} -> {g.after:.3g} {g.unit}: {gained}"
        refused = "; so it is not corrected" if found.refuted else ""
        lines.append(Text(f"{words}{refused}."))
    named = [u for u in found.unexplained if _is_named(u)]
    told = [f"{in_words(u.name)} ({per_cent(u.probability)})" for u in named]
    nameless = [
        in_words(u.name) + (f" (driven by {u.driver})" if u.driver else "")
        for u in found.unexplained
        if not _is_named(u)
    ]
    for words, every in (("Named, but not corrected", told), ("Unexplained structure", nameless)):
        if every:
            more = f", and {len(every) - _OPEN} more" if len(every) > _OPEN else ""
            lines.append(Text(f"{words}: {'; '.join(every[:_OPEN])}{more}.", "warning"))
    if found.verdict == "not run":
        lines.append(Text("What the model lacks was not searched for."))
    elif not lines:
        lines.append(_nothing_found(found))
    return lines


def _is_named(one: Unexplained) -> bool:
    """Whether it is a cause of the catalogue, likelier than not."""
    return bool(known(one.name)) and names_a_cause(one.name) and one.probability > _EVEN


def _describe_step(step: Step) -> str:
    """An effect and its size in words."""
    if step.curve:
        return f"A curve without a name, {step.curve}"
    own = step.parameters
    words = ", ".join(plus_minus(p.value, p.sd, p.unit) for p in own[:_PARAMETERS])
    size = step.size or (words if len(own) <= _PARAMETERS else f"{len(own)} parameters")
    return capital(step.formula or in_words(step.effect)) + (f": {size}" if size else "")


def _doubt(step: Step, found: Findings) -> str:
    """What else it may be, how likely each is, and whether data that took no part prove it."""
    others = [one for one in step.in_its_place if one.effect != step.effect][:_RIVALS]
    doubts = []
    if not math.isnan(step.probability) and not others:
        doubts.append(per_cent(step.probability))
    elif not math.isnan(step.probability):
        own = sum(one.share for one in step.in_its_place if one.effect == step.effect)
        rest = 1.0 - own - sum(one.share for one in others)
        words = [f"{in_words(one.effect)} {per_cent(one.share)}" for one in others]
        words += [f"something else {per_cent(rest)}"] if rest > 0.005 else []
        doubts.append(f"{per_cent(own)}; or {', '.join(words)}")
    elif step.aliases:
        doubts.append(f"or {' or '.join(map(in_words, step.aliases))}")
    if found.verdict == "suspected":
        doubts.append("corrected; held-out gain not significant")
    return f" ({'; '.join(doubts)})" if doubts else ""


def _nothing_found(found: Findings) -> Text:
    """How likely it is that nothing is missing, and what could be; a tick above even odds."""
    likely = [s for s in found.scores if s.probability > _LIKELY][:_NAMED]
    names = ", ".join(f"{in_words(s.name)} {per_cent(s.probability)}" for s in likely)
    could = f"; what could be missing: {names}" if names else ""
    said = f"No missing effect was detected: nothing is missing with {per_cent(found.complete)}"
    return Text(f"{said}{could}.", "ok" if found.complete > _EVEN else "plain")


def _why(outcome: Outcome) -> list[str]:
    """Reasons for a caution."""
    # A wrong record is said by what is undecided about it, what stays by the card.
    elsewhere = ("record errors",) * bool(outcome.undecided) + _IN_FULL
    why = [r for r in outcome.reasons if not r.startswith(elsewhere)]
    if len(why) < len(outcome.reasons) and not outcome.undecided:
        why.append(NO_NAME)
    if outcome.status == "marginal" and not (why or outcome.undecided):
        suspected = outcome.findings is not None and outcome.findings.verdict == "suspected"
        why.append(UNPROVED_NAME if suspected else NO_NAME)
    return why


def _compose_loop_section(outcome: Outcome) -> Section:
    """The effects that were added, what could hide, and the error before and after; the card says
    in words what was found."""
    found = outcome.findings or Findings("not run")
    note = _HELD_OUT.get(outcome.calibrator, _HELD_OUT[""])
    if found.steps and outcome.calibrator != "array":
        note = _ANEW
    judged = [e for e in outcome.errors if not (math.isnan(e.base) and math.isnan(e.held_out.base))]
    errors = [_error_table(e, note if e is judged[-1] else "") for e in judged]
    blocks: list[Block] = []
    if any(size for _, size in found.declared):
        blocks.append(Table("Declared effects", ("effect", "size"), found.declared, "ll"))
    limited = (("only", found.only), ("without", found.without))
    if limits := [f"{words} {', '.join(names)}" for words, names in limited if names]:
        blocks.append(Text(f"The search was limited: {'; '.join(limits)}."))
    kinds = dict.fromkeys(tuple(c.metric for c in s.checks) for s in found.steps)
    for kind in kinds:
        steps = [s for s in found.steps if tuple(c.metric for c in s.checks) == kind]
        blocks.append(_step_table(steps))
    blocks += [*_power(found), *errors]
    if found.facts:
        blocks.append(Facts(found.facts))
    return Section("Closed loop", tuple(blocks))


def _error_table(error: ErrorSummary, note: str) -> Table:
    """Error before and after, fitted and on data that was not fitted, with the floor."""
    digits = 3 if error.unit == "m/s²" else 2
    held, fitted = error.held_out, not (math.isnan(error.base) and math.isnan(error.final))
    rows = [
        (name, *[number(before, digits)] * fitted, number(after, digits))
        for name, before, after in (
            ("raw reading", error.raw, held.raw),
            ("base model", error.base, held.base),
            ("final model", error.final, held.final),
        )
        if fitted or not math.isnan(after)
    ]
    rows.append(("noise floor", number(error.floor, digits, "unknown"), *[""] * fitted))
    header = ("", *["fitted"] * fitted, "held out")
    title = f"Error before and after ({error.metric}, {error.unit})"
    return Table(title, header, tuple(rows), "", note)


def _step_table(steps: Sequence[Step]) -> Table:
    """Effects that were added; a column of sizes and of nats held out where a calibrator has it."""
    sized, nats = (any(getattr(s, name) for s in steps) for name in ("size", "held_out_nats"))

    def row(s: Step) -> tuple[str, ...]:
        cells = [s.effect, *[s.size] * sized, per_cent(s.probability)]
        if nats:
            cells += [f"{s.evidence_nats:.1f}", ", ".join(f"{v:.0f}" for v in s.held_out_nats)]
        for c in s.checks:
            cells.append(f"{c.before:.{c.digits}f} -> {c.after:.{c.digits}f} {c.unit}")
        rivals = (one for one in s.in_its_place if one.effect != s.effect)
        others = ", ".join(f"{one.effect} {per_cent(one.share)}" for one in rivals)
        others = others if s.in_its_place else ", ".join(s.aliases)
        return (*cells, others or ("nothing: certain" if s.certain else "-"))

    header = ["effect added", *["size"] * sized, "P(present)", *["nats", "held out, nats"] * nats]
    header += [*(capital(c.metric) for c in steps[0].checks), "indistinguishable from"]
    align = "l" + "l" * sized + "r" * (len(header) - 2 - sized) + "l"
    note = "Errors of all steps together. P(present): of this effect, in this place or another."
    note += " Nats held out: what each half gains by the effect as the other half has it." * nats
    return Table("Steps of the loop", tuple(header), tuple(map(row, steps)), align, note)


def _power(found: Findings) -> list[Text]:
    """What may be there unseen, and how large."""
    every = find_hidden(found.scores, [s.effect for s in found.steps])
    absorbed = [f"{in_words(h.name)} ({h.size / MG:.2g} mg)" for h in every if h.absorbed]
    weak = [f"{in_words(h.name)} {h.size / MG:.2g} mg" for h in every if not h.absorbed][:_WEAK]
    said = []
    if absorbed:
        text = "Not identifiable from these data (rms at a typical size): "
        said.append(Text(f"{text}{', '.join(absorbed)}.", "warning"))
    if weak:
        text = "Could be present undetected (80 % power), rms on a reading: up to "
        said.append(Text(f"{text}{', '.join(weak)}."))
    return said


def _compose_candidate_section(found: Findings) -> Section:
    """Every candidate of the last search with its numbers, why not, and what cannot be shown."""
    # A scan has hundreds of members.
    shown = [s for s in found.scores if "@" not in s.name or s.evidence_nats > 1.0]
    note = (
        "Last search, after everything above was added. Identifiable: share of the effect that the "
        "fitted parameters do not absorb. λ: strength at typical size; about 4.7 gives an 80 % "
        "chance to find it. Size: what it does to a reading at typical size, rms; an absorbed "
        "effect cannot be tested on these data and shifts the answer by so much."
    )
    blocks: list[Block] = [Table.from_columns(_CANDIDATES, shown, "All candidates", note)]
    reasons = (*found.rejected, *found.missing.items())
    if why := "; ".join(f"{name}: {reason}" for name, reason in reasons):
        blocks.append(Text(f"Rejected or not tested: {why}."))
    if found.not_testable:
        cells = tuple((u.effect, u.typical, f"{u.shift:.2g} {u.unit}") for u in found.not_testable)
        heads = ("not testable", "at", "moves the answer by")
        note = "Absorbed by what is fitted, or by effects already in the model."
        blocks.append(Table("What these data cannot show", heads, cells, "llr", note))
    return Section("Candidates tried", tuple(blocks))


def parameter_table(calibration: Calibration, note: str, shares: Sequence[float] = ()) -> Table:
    """Every parameter with its standard deviation, but those of an effect of many.

    shares : of what is known of each, what the recording has shown; none where that is not told
    """
    counts = Counter(p.effect for p in calibration.parameters)
    rows = []
    for k, p in enumerate(calibration.parameters):
        if counts[p.effect] <= _MOST_ROWS:
            shown = [f"{100.0 * shares[k]:.0f}"] if shares else []
            rows.append((p.name, p.effect, *format_with_sd(p.value, p.sd), p.unit, *shown))
    many = ", ".join(f"{name} ({n} terms)" for name, n in counts.items() if n > _MOST_ROWS)
    note += f" In calibration.yaml only: {many}." if many else ""
    header = ("parameter", "effect", "value", "sd", "unit", *["data, %"] * bool(shares))
    return Table("Parameters", header, tuple(rows), "llrrlr"[: len(header)], note)


def compose_sensor_section(calibration: Calibration) -> Section:
    """M, b and the scales, and the angles between the sensing axes."""
    linear = calibration.matrices()
    rows = tuple(
        (
            letter,
            format_components(linear.M[k], 6),
            f"{linear.b[k] / MG:+.3f}",
            *format_with_sd(linear.scale[k], linear.scale_sd[k]),
        )
        for k, letter in enumerate("xyz")
    )
    header = ("axis", "M", "b, mg", "scale", "sd")
    note = "The linear part. Scale: sensitivity of each axis, free of the frame."
    table = Table("corrected = M raw + b", header, rows, "llrrr", note)
    angles = zip(("xy", "xz", "yz"), linear.angle, linear.angle_sd, strict=True)
    facts = Facts(tuple((f"angle {p}", plus_minus(a, s, "deg")) for p, a, s in angles))
    return Section("The sensor", (table, facts))


def compose_kind_section(
    kind: Population | None, fit: Fit, chance: float, what: str, alone: Fit | None = None
) -> Section:
    """Empty without a fleet. chance : that one of the kind is as far from it; what : was recorded,
    in words; alone : the fit without the fleet, where there is one"""
    prior = fit.prior
    if kind is None or prior is None:
        return Section("Fleet prior", ())
    own = {p.name: sd for p, sd in zip(alone.parameters, alone.sd, strict=True)} if alone else {}
    before = np.sqrt(np.diag(prior.covariance))
    rows = []
    for p, m, b, v, s in zip(fit.parameters, prior.mean, before, fit.theta, fit.sd, strict=True):
        cells = [plus_minus(m, b, p.unit), plus_minus(v, s, p.unit)]
        cells.append(f"{100.0 * max(0.0, 1.0 - (s / b) ** 2):.0f}")
        if own:
            cells.append(size_with_unit(own[p.name], p.unit) if p.name in own else "-")
        rows.append((p.name.replace("_", " "), *cells))
    count = fit.observations.n
    words = (
        f"{kind.devices} devices of its kind say what to expect, {count} {what}"
        f"{'s' * (count != 1)} of this one the rest. Chance that one of the kind is as far from "
        f"the others: {probability(chance, 999)}."
    )
    header = ("", "of its kind", "this device", "from its own, %", *["sd without"] * bool(own))
    note = "From its own: share of the variance of its kind that its data have taken away."
    note += " Without: by its own data and the typical sizes alone." if own else ""
    table = Table("", header, tuple(rows), "", note)
    return Section("Fleet prior", (Text(words), table))
