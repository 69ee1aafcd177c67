"""The report of `imucal actigraph`, as data."""

from __future__ import annotations

from pathlib import Path

from imucalib.calibration.outcome import Status
from imucalib.calibrators.actigraph.advice import weakest
from imucalib.calibrators.actigraph.calibration import actigraph_calibration, coverage_block
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.calibrators.actigraph.run import ActigraphRun
from imucalib.calibrators.actigraph.weak import from_data
from imucalib.report.actigraph.plots import residual_plots, sphere_blocks
from imucalib.report.actigraph.series import series_section
from imucalib.report.document import Document, Facts, Section, Table, Text, Tone
from imucalib.report.loop import advice_section, candidate_section, loop_section
from imucalib.report.matrices import linear_blocks
from imucalib.rests.runs import PostureRuns
from imucalib.significant_digits import with_sd
from imucalib.units import MG

_TONE: dict[Status, Tone] = {"ok": "ok", "marginal": "warning", "weak": "warning", "failed": "bad"}
_MOST_ROWS = 12  # parameters of one effect that are shown in full


def actigraph_document(run: ActigraphRun) -> Document:
    """Everything that a reader of the calibration must know, headline first."""
    outcome = run.outcome
    sections = [
        loop_section(outcome),
        _parameters(run),
        _coverage(run),
        advice_section(outcome),
        Section("Residual before and after", residual_plots(run), brief=False),
        Section("Error over the sphere", sphere_blocks(run), brief=False),
        _sensor(run),
    ]
    if run.series:
        sections.insert(1, series_section(run.series))
    if outcome.loop:
        sections.append(candidate_section(outcome.loop))
    return Document(
        f"Calibration of {Path(run.scanned.path).name} by gravity",
        _verdict(run),
        tuple(sections),
        run.outcome.provenance.footer,
    )


def _verdict(run: ActigraphRun) -> Text:
    outcome, error = run.outcome, run.outcome.error
    head = (
        f"Error at rest on held-out time {error.held_out.raw:.2f} mg raw, "
        f"{error.held_out.base:.2f} with nine parameters, {error.held_out.final:.2f} final."
    )
    broken = [
        f"{x.name}: {x.value:.3g} {x.unit} exceeds {x.limit:g}" for x in outcome.limits if x.broken
    ]
    declined = (run.result.declined,) if run.result.declined else ()
    why = [f"{r[0].upper()}{r[1:]}" for r in (*outcome.reasons, *declined)]
    return Text(" ".join([head, *(f"{t}." for t in (*broken, *why))]), _TONE[outcome.status])


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


def _coverage(run: ActigraphRun) -> Section:
    block, runs = coverage_block(run), run.runs
    mean_sd, largest = weakest(run.result)
    span = ", ".join(
        f"{a} {low:+.2f} to {high:+.2f} g" for a, (low, high) in block["axis_range_g"].items()
    )
    rows = [
        ("recorded", f"{block['hours']:.1f} h at {block['rate_hz']:g} Hz"),
        ("at rest", f"{runs.still} of {runs.total} windows of {run.request.window:g} s, "
                    f"{runs.n} posture runs"),
        ("seen of gravity", span),
        ("|a| is known to", f"{mean_sd:.2f} mg on average over all directions, "
                            f"{largest:.2f} mg in the worst"),
        ("noise", f"{', '.join(f'{v:.2g}' for v in runs.noise / MG)} mg a sample{_steps(runs)}"),
        ("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})"),
    ]  # fmt: skip
    if "temperature_degC" in block:
        low, high = block["temperature_degC"]
        rows.append(("temperature", f"{low:.1f} to {high:.1f} °C; reference 25 °C"))
    if run.result.light:
        rows.append(("count less", f"{run.result.light} runs that nothing else is like"))
    rows += [("note", text) for text in run.outcome.notes]
    return Section("What was recorded", (Facts(tuple(rows)),))


def _steps(runs: PostureRuns) -> str:
    """The resolution, and whether the noise averages it out."""
    step = float(runs.resolution.max()) / MG
    if step < 0.05 * float(runs.noise.min()) / MG:  # numbers as fine as their format
        return ""
    size = quantisation(runs) / MG
    if size == 0.0:
        return f"; the smallest step, {step:.2g} mg, averages out"
    return f"; the smallest step, {step:.2g} mg, does not average out: {size:.2g} mg a posture"


def _sensor(run: ActigraphRun) -> Section:
    linear = actigraph_calibration(run).matrices()
    note = "The linear part. Scale: sensitivity of each axis, free of the frame."
    table, angles = linear_blocks(linear, note)
    return Section("The sensor", (table, angles), brief=False)
