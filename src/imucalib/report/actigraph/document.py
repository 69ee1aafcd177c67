"""The report of `imucal actigraph`, as data."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucalib.calibrators.actigraph.coverage import Coverage
from imucalib.calibrators.actigraph.errors import norm_sd
from imucalib.calibrators.actigraph.observations import from_data
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.core.sphere import even_directions
from imucalib.report.actigraph.activity import activity_section, rule_section
from imucalib.report.actigraph.card import actigraph_card
from imucalib.report.actigraph.plots import residual_plots, sphere_blocks
from imucalib.report.actigraph.series import series_section
from imucalib.report.document import Document, Facts, Section, Table, Text
from imucalib.report.loop import TERMS, advice_section, candidate_section, gain_plot, loop_section
from imucalib.report.sections import kind_section, sensor_section, verdict
from imucalib.significant_digits import probability, with_sd
from imucalib.units import MG

_MOST_ROWS = 12  # parameters of one effect that are shown in full


def actigraph_document(run: ActigraphRun) -> Document:
    """Everything that a reader of the calibration must know, headline first."""
    outcome = run.outcome
    sections = [
        _of_a_kind(run),
        activity_section(run),
        loop_section(outcome),
        _parameters(run),
        _coverage(run),
        advice_section(outcome),
        Section(
            "Residual before and after",
            (*gain_plot(outcome.findings), *residual_plots(run)),
            brief=False,
        ),
        Section("Error over the sphere", sphere_blocks(run), brief=False),
        rule_section(run),
        sensor_section(run.calibration),
    ]
    if run.series:
        sections.insert(3, series_section(run.series))
    if outcome.findings:
        sections.append(candidate_section(outcome.findings))
    return Document(
        f"Calibration of {Path(run.scanned.path).name} by gravity",
        _verdict(run),
        tuple(s for s in sections if s.blocks),
        run.outcome.provenance.footer,
        actigraph_card(run),
        TERMS,
    )


def _verdict(run: ActigraphRun) -> Text:
    error = run.outcome.error
    head = (
        f"Error at rest on held-out time {error.held_out.raw:.2f} mg raw, "
        f"{error.held_out.base:.2f} with nine parameters, {error.held_out.final:.2f} final."
    )
    return verdict(run.outcome, head)


def _parameters(run: ActigraphRun) -> Section:
    fit = run.result.final
    share = from_data(fit)
    rows: list[tuple[str, ...]] = []
    hidden = []
    for name, part in fit.model.slices(fit.observations.context).items():
        if part.stop - part.start > _MOST_ROWS:
            hidden.append(f"{name} ({part.stop - part.start} terms)")
            continue
        for k in range(part.start, part.stop):
            p = fit.parameters[k]
            value = with_sd(float(fit.theta[k]), float(fit.sd[k]))
            rows.append((p.name, name, *value, p.unit, f"{100.0 * share[k]:.0f}"))
    note = (
        "Uncertainty by posture run: windows of one posture are not independent. Data: the share "
        "of what is known that the recording has shown, 1 - (sd / typical size)²."
    )
    if hidden:
        note += f" In calibration.yaml only: {', '.join(hidden)}."
    table = Table("Parameters", ("parameter", "effect", "value", "sd", "unit", "data, %"),
                  tuple(rows), "llrrlr", note)  # fmt: skip
    return Section("Parameters", (table,))


def _of_a_kind(run: ActigraphRun) -> Section:
    """What a fleet said, and what that does to the uncertainty."""
    said, fit = run.result.of_a_kind, run.result.final
    if said is None:
        return Section("The fleet's word", ())
    if np.isnan(said.strange):
        words = "Its own postures tell all nine parameters so well that the fleet was not needed."
        return Section("The fleet's word", (Text(words, "plain"),))
    if not said.taken:
        words = (
            "Not believed: one of the fleet's kind is as far off with a chance of "
            f"{probability(said.strange, 999)}. The calibration is the recording's own."
        )
        return Section("The fleet's word", (Text(words, "warning"),))
    told = kind_section(said.kind, fit, said.strange, "posture run", said.alone)
    before, now = (
        1.96 * float(norm_sd(one, even_directions()).max()) / MG for one in (said.alone, fit)
    )
    words = (
        f"|a| is known to ± {now:.2g} mg (95 %) in the worst attitude, without the fleet to "
        f"± {before:.2g} mg."
    )
    return Section(told.title, (*told.blocks, Text(words, "plain")))


def _coverage(run: ActigraphRun) -> Section:
    c = run.coverage
    span = ", ".join(
        f"{a} {low:+.2f} to {high:+.2f} g" for a, (low, high) in zip("xyz", c.span.T, strict=True)
    )
    rows = [
        ("recorded", f"{c.hours:.1f} h at {c.rate:g} Hz"),
        ("at rest", f"{c.still} of {c.windows} windows of {c.window:g} s, {c.runs} posture runs"),
        ("seen of gravity", span),
        ("|a| is known to", f"{c.mean_sd:.2f} mg on average over all directions, "
                            f"{c.worst_sd:.2f} mg in the worst"),
        ("noise", f"{', '.join(f'{v:.2g}' for v in c.noise)} mg a sample{_steps(c)}"),
        ("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})"),
    ]  # fmt: skip
    if c.temperature is not None:
        low, high = c.temperature
        rows.append(("temperature", f"{low:.1f} to {high:.1f} °C; reference 25 °C"))
    if c.light:
        rows.append(("count less", f"{c.light} runs that nothing else is like"))
    rows += [("note", text) for text in run.outcome.notes]
    return Section("What was recorded", (Facts(tuple(rows)),))


def _steps(coverage: Coverage) -> str:
    """The resolution, and whether the noise averages it out."""
    step = float(coverage.resolution.max())
    if step < 0.05 * float(coverage.noise.min()):  # numbers as fine as their format
        return ""
    size = coverage.quantisation
    if size == 0.0:
        return f"; the smallest step, {step:.2g} mg, averages out"
    return f"; the smallest step, {step:.2g} mg, does not average out: {size:.2g} mg a posture"
