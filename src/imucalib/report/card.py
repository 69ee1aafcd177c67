"""The card at the head of every calibration's report: worth, what was found, what to do next."""

from __future__ import annotations

import math
from typing import Any

from imucalib.calibration.findings import Findings, FoundStep
from imucalib.calibration.outcome import ErrorSummary, Outcome
from imucalib.effects import known
from imucalib.effects.shape import in_words
from imucalib.report.document import Card, Text, Tone, Worth
from imucalib.report.loop import density_words, likeliest_words, refuted_words
from imucalib.significant_digits import per_cent, plus_minus, two_digits
from imucalib.units import MG

#: Parameters of one effect that a card names, steps of advice that it gives, names left open.
_PARAMETERS, _STEPS, _LEFT = 3, 4, 3
#: Effects whose meaning is told: of more the names must do.
_TOLD, _RIVALS = 3, 3
#: What stands between a slip and the option that repairs it.
_DECIDE = "; decide with"
_USE = (
    "Use it: `imucal apply calibration.yaml RECORDING -o corrected.mcap`, or "
    "`imucal export calibration.yaml --to c-header`."
)


def card_of(outcome: Outcome, good_to: tuple[Worth, ...], *more: str) -> Card:
    """The card of a run.

    good_to : what the calibrator can promise; more : advice of the calibrator's own, told last
    """
    slips = _slips(outcome)
    told = [Text(f"{text.partition(_DECIDE)[0]}.", "bad") for text in slips]
    searched = not slips or bool(outcome.findings and outcome.findings.verdict != "not run")
    found = _found(outcome.findings or Findings("not run")) if searched else ()
    return Card(good_to, (*told, *found), _to_do(outcome, more), outcome.provenance.command)


def _slips(outcome: Outcome) -> tuple[str, ...]:
    """What only the user can decide, beside the wrong records that the search has named."""
    named = tuple(f"{r.where}:" for r in outcome.findings.records) if outcome.findings else ()
    return tuple(text for text in outcome.undecided if not text.startswith(named or ("\0",)))


def like_these(what: str, share: float) -> str:
    """What a held-out error holds for: data that are held out are of the same attitudes as the
    rest. share : of the sphere that is near one of them."""
    return f", for {what} like these, {100.0 * share:.0f} % of all directions"


def error_worth(error: ErrorSummary, quantity: str, of: str = "data", holds_for: str = "") -> Worth:
    """A held-out error as worth, with what it was before; the fitted one where none was held out.

    of : what was held out, for example "positions"; holds_for : see `like_these`
    """
    held, unit, size = error.held_out, error.unit, 1.0
    if unit == "m/s²":  # people read accelerations in mg
        unit, size = "mg", MG
    final, base, raw = (v / size for v in (held.final, held.base, held.raw))
    if math.isnan(final):
        how = error.metric.rpartition(", ")[2]
        fitted = f"{two_digits(error.final / size)} {unit}"
        return Worth(quantity, fitted, f"{how}, fitted; nothing was held out")
    before = [] if math.isnan(raw) else [f"raw reading {two_digits(raw)}"]
    if not math.isnan(base):
        before.append(f"before the search {two_digits(base)}")
    what = f"{error.metric.rpartition(', ')[2]} on {of} held out{holds_for}"
    detail = f"{what}; {', '.join(before)}"
    return Worth(quantity, f"{two_digits(final)} {unit}", detail.rstrip("; "))


def _found(found: Findings) -> tuple[Text, ...]:
    """In the order in which a reader must know it."""
    tones: dict[str, Tone] = {"explained": "ok", "suspected": "warning"}
    few = len(found.steps) <= _TOLD
    lines = [
        Text(
            f"{r.where}: {r.channel} is {plus_minus(r.size, r.sd, r.unit)} off "
            f"({r.likely}, {per_cent(r.probability)}).",
            "bad",
        )
        for r in found.records
    ]
    lines += [
        Text(
            f"{_sized(step)}{_doubt(step, found)}.{_meaning(step) if few else ''}",
            tones.get(found.verdict, "plain"),
        )
        for step in found.steps
    ]
    if found.gain is not None and found.steps:
        g = found.gain
        aside = ", the wrong records set aside," if found.records else ""
        dense = "" if math.isnan(g.nats) else f"; {density_words(g)}"
        lines.append(Text(
            f"On held-out data{aside} {g.before:.3g} -> {g.after:.3g} {g.unit}: gain "
            f"{g.before - g.after:.2g}, 95 % {g.low:.2g} to {g.high:.2g}{dense}."
        ))  # fmt: skip
    left = [f"{u.name} (driven by {u.driver})" if u.driver else u.name for u in found.unexplained]
    if left:
        more = f", and {len(left) - _LEFT} more" if len(left) > _LEFT else ""
        lines.append(Text(f"Left without a name: {'; '.join(left[:_LEFT])}{more}.", "warning"))
    if found.verdict == "not run":
        lines.append(Text("What the model lacks was not searched for."))
    elif not (lines or found.records):
        shown = f", as far as these data show{likeliest_words(found)}"
        why = f": {refuted_words(found)}" if found.refuted else shown
        lines.append(Text(f"Nothing is missing from the model{why}.", "ok"))
    return tuple(lines)


def _sized(step: FoundStep) -> str:
    """An effect and its size in words."""
    if step.curve:
        return f"A curve without a name, {step.curve}"
    name = step.formula or in_words(step.effect)
    own = step.parameters
    words = ", ".join(plus_minus(p.value, p.sd, p.unit) for p in own[:_PARAMETERS])
    size = step.size or (words if len(own) <= _PARAMETERS else f"{len(own)} parameters")
    return f"{name[0].upper()}{name[1:]}" + (f": {size}" if size else "")


def _meaning(step: FoundStep) -> str:
    """What the effect is, in one sentence; of the bench's own the steps to take say it."""
    effect = known(step.effect)
    if effect is None or effect.stage == "fixture" or step.curve or step.formula:
        return ""
    return f" {effect.sentence}"


def _doubt(step: FoundStep, found: Findings) -> str:
    """What else it may be, and whether data that took no part prove it."""
    doubts = []
    if not math.isnan(step.probability):
        doubts.append(_likely(step))
    elif step.aliases:
        doubts.append(f"or {' or '.join(map(in_words, step.aliases))}")
    if found.verdict == "suspected":
        doubts.append("not proved by held-out data, yet corrected")
    return f" ({'; '.join(doubts)})" if doubts else ""


def _likely(step: FoundStep) -> str:
    """How likely it is there, and what stands in its place."""
    others = [(n, s) for n, s in step.rivals if n != step.effect][:_RIVALS]
    own = sum(share for n, share in step.rivals if n == step.effect)
    rest = 1.0 - own - sum(share for _, share in others)
    words = [f"{in_words(name)} {per_cent(share)}" for name, share in others]
    if not words:
        return per_cent(step.probability)
    more = [f"something else {per_cent(rest)}"] if rest > 0.005 else []
    return f"{per_cent(own)}; or {', '.join(words + more)}"


def _to_do(outcome: Outcome, more: tuple[str, ...]) -> tuple[str, ...]:
    """The next steps; that the result can be used where nothing forbids it."""
    slips = [f"{text[0].upper()}{text[1:]}." for text in _slips(outcome)]
    if slips:  # until then the rest of the advice is about an error that is none of the sensor's
        return (*slips[:_STEPS], "Then run it again: only then the figures are the sensor's.")
    steps = [*(f"{text}." for text in outcome.broken), *outcome.advice, *more][:_STEPS]
    if outcome.status in ("ok", "marginal") and not outcome.undecided:
        steps.append(_USE)
    return tuple(steps) or ("Nothing to do.",)


def card_dict(card: Card) -> dict[str, Any]:
    """Plain types, ready for JSON."""
    return {
        "good_to": [vars(worth) for worth in card.good_to],
        "found": [text.text for text in card.found],
        "to_do": list(card.to_do),
        "command": card.command,
    }
