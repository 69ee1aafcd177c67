"""What the report of every calibrator has, and the whole report of one that has no own."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.outcome import Outcome, Run, Status
from imucalib.calibrators.population import Population
from imucalib.core.fit import Fit
from imucalib.report.card import card_of, error_worth
from imucalib.report.document import Document, Facts, Section, Table, Text, Tone
from imucalib.report.loop import TERMS, advice_section, candidate_section, floor_words, loop_section
from imucalib.significant_digits import plus_minus, probability, with_sd
from imucalib.units import MG


def kind_section(
    kind: Population | None, fit: Fit, strange: float, what: str, alone: Fit | None = None
) -> Section:
    """Empty without a fleet. strange : chance that one of the kind is as far from it; what : was
    recorded, in words; alone : the fit without the fleet, where there is one"""
    prior = fit.prior
    if kind is None or prior is None:
        return Section("The fleet's word", ())
    own = {} if alone is None else dict(zip((p.name for p in alone.parameters), alone.sd,
                                            strict=True))  # fmt: skip
    before = np.sqrt(np.diag(prior.covariance))
    rows = tuple(
        (
            p.name.replace("_", " "),
            plus_minus(float(m), float(b), p.unit),
            plus_minus(float(v), float(s), p.unit),
            f"{100.0 * max(0.0, 1.0 - (s / b) ** 2):.0f}",
            *(
                (
                    f"{own[p.name]:.2g} {p.unit.removeprefix('1')}".rstrip()
                    if p.name in own
                    else "-",
                )
                if own
                else ()
            ),
        )
        for p, m, b, v, s in zip(fit.parameters, prior.mean, before, fit.theta, fit.sd, strict=True)
    )
    count = fit.observations.n
    chance = probability(strange, 999)
    own_rows = f"{count} {what}{'s' * (count != 1)}"
    words = (
        f"{kind.devices} devices of its kind say what to expect, {own_rows} of this one the rest. "
        f"Chance that one of the kind is as far from the others: {chance}."
    )
    table = Table(
        "",
        ("", "of its kind", "this device", "from its own, %", *(("sd without",) if own else ())),
        rows, "lrrr" + "r" * bool(own),
        "From its own: share of the variance of its kind that its data have taken away."
        + (" Without: by its own data and the typical sizes alone." if own else ""),
    )  # fmt: skip
    return Section("The fleet's word", (Text(words, "plain"), table))


#: How reasons begin that the card tells in full.
_LEFT = ("unexplained structure", "structure that no effect")
_UNPROVED = "held-out data do not prove what was found"
_NAMELESS = "what stays has no name yet"
_TONE: dict[Status, Tone] = {"ok": "ok", "marginal": "warning", "weak": "warning", "failed": "bad"}


def standard_document(run: Run) -> Document:
    """Everything that a reader of any calibration must know, headline first."""
    outcome, calibration = run.outcome, run.calibration
    error = outcome.error
    head = (
        f"Held-out {error.metric} {error.held_out.base:.3g} {error.unit} before, "
        f"{error.held_out.final:.3g} {error.unit} after {floor_words(error, 3)}."
    )
    sections = [
        loop_section(outcome),
        Section("Parameters", (parameter_table(calibration, ""),)),
        advice_section(outcome),
    ]
    if not calibration.triads:
        sections.append(sensor_section(calibration))
    sections += closing_sections(outcome)
    title = f"Calibration of {outcome.provenance.path} by {outcome.calibrator}"
    card = card_of(outcome, (error_worth(error, error.metric),))
    return Document(
        title, verdict(outcome, head), tuple(sections), outcome.provenance.footer, card, TERMS
    )


def verdict(outcome: Outcome, head: str, beside: Sequence[str] = ()) -> Text:
    """The headline: a figure, broken limits, what is undecided, and reasons; toned by the status.

    beside : sentences of the calibrator's own, after the reasons
    """
    # A wrong record is told by what is undecided about it, what stays by the card.
    known = ("record errors",) * bool(outcome.undecided) + _LEFT
    told = [r for r in outcome.reasons if not r.startswith(known)]
    if len(told) < len(outcome.reasons) and not outcome.undecided:
        told.append(_NAMELESS)
    if outcome.status == "marginal" and not (told or beside or outcome.undecided):
        suspected = outcome.findings is not None and outcome.findings.verdict == "suspected"
        told.append(_UNPROVED if suspected else _NAMELESS)
    why = [f"{r[0].upper()}{r[1:]}" for r in (*told, *beside)]
    text = " ".join([head, *(f"{t}." for t in (*outcome.broken, *outcome.undecided, *why))])
    return Text(text, _TONE[outcome.status])


def parameter_table(calibration: Calibration, note: str) -> Table:
    """Every parameter with its standard deviation."""
    rows = tuple(
        (p.name, p.effect, *with_sd(p.value, p.sd), p.unit) for p in calibration.parameters
    )
    return Table("Parameters", ("parameter", "effect", "value", "sd", "unit"), rows, "llrrl", note)


def sensor_section(calibration: Calibration, *more: Table) -> Section:
    """M, b and the scales, and the angles between the sensing axes."""
    linear = calibration.matrices()
    rows = tuple(
        (
            letter,
            "  ".join(f"{v:+.6f}" for v in linear.M[k]),
            f"{linear.b[k] / MG:+.3f}",
            *with_sd(float(linear.scale[k]), float(linear.scale_sd[k])),
        )
        for k, letter in enumerate("xyz")
    )
    header = ("axis", "M", "b, mg", "scale", "sd")
    note = "The linear part. Scale: sensitivity of each axis, free of the frame."
    table = Table("corrected = M raw + b", header, rows, "llrrr", note)
    angles = Facts(
        tuple(
            (f"angle {pair}", plus_minus(float(a), float(s), "deg"))
            for pair, a, s in zip(("xy", "xz", "yz"), linear.angle, linear.angle_sd, strict=True)
        )
    )
    return Section("The sensor", (table, angles, *more), brief=False)


def closing_sections(outcome: Outcome) -> tuple[Section, ...]:
    """The candidates, where there was a search, and the notes."""
    found = (candidate_section(outcome.findings),) if outcome.findings else ()
    notes = tuple(Text(n) for n in outcome.notes)
    return (*found, *((Section("Notes", notes, brief=False),) if notes else ()))
