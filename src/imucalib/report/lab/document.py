"""The report of `imucal lab`, as data."""

from __future__ import annotations

import numpy as np

from imucalib.calibrators.lab.attitude import AttitudeErrors, attitude_errors, rms, worst
from imucalib.calibrators.lab.dial import bends, dial_words
from imucalib.calibrators.lab.errors import reading_noise, setting_noise
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.fit import Fit
from imucalib.core.references import KnownVector
from imucalib.loop.held_out import Held, fitted
from imucalib.report.document import Block, Document, Facts, Section, Table, Text
from imucalib.report.lab.card import lab_card
from imucalib.report.lab.plots import dial_section, uncertainty_section
from imucalib.report.lab.residuals import attitude_map, residual_plots
from imucalib.report.lab.sessions import sessions_section
from imucalib.report.lab.tables import iscwsa_table, position_table, published_table, training_note
from imucalib.report.loop import (
    TERMS,
    advice_section,
    candidate_section,
    floor_words,
    gain_plot,
    loop_section,
)
from imucalib.report.sections import kind_section, parameter_table, sensor_section, verdict
from imucalib.significant_digits import plus_minus, spread
from imucalib.units import DEG, MG


def lab_document(run: LabRun) -> Document:
    """Everything that a reader of the calibration must know, headline first."""
    outcome = run.outcome
    sections = [
        loop_section(outcome),
        Section(
            "Residual before and after",
            (*gain_plot(outcome.findings), *residual_plots(run), attitude_map(run)),
            brief=False,
        ),
        _angle_section(run),
        _parameter_section(run),
        kind_section(
            run.request.settings.population, run.result.final, run.result.strange, "position"
        ),
        _bench_section(run),
        sessions_section(run.sessions),
        dial_section(run),
        advice_section(outcome),
        sensor_section(run.calibration, iscwsa_table(run.calibration)),
        uncertainty_section(run),
        Section("Positions", (position_table(run),), brief=False),
    ]
    if outcome.findings:
        sections.append(candidate_section(outcome.findings))
    if run.request.settings.objective == "paper":
        sections.append(Section("As published", (published_table(run),), brief=False))
    return Document(
        f"Lab calibration of {outcome.provenance.path}",
        _verdict(run),
        tuple(s for s in sections if s.blocks),
        run.outcome.provenance.footer,
        lab_card(run),
        TERMS,
    )


def _verdict(run: LabRun) -> Text:
    error = run.outcome.error
    head = (
        f"Held-out error {error.held_out.raw:.2f} raw, {error.held_out.base:.2f} base, "
        f"{error.held_out.final:.2f} {error.unit} rms final {floor_words(error)}."
    )
    return verdict(run.outcome, head)


def _parameter_section(run: LabRun) -> Section:
    factor = run.result.final.noise.factor
    note = "sd with the noise as estimated"
    if reading_noise(run.result.final).own > 0.0:
        note += (
            f" ({factor:.2f} times the declared or assumed one); with the declared noise taken at "
            f"its word, divide by {factor:.2f}"
        )
    note += "."
    return Section("Parameters", (parameter_table(run.calibration, note),))


def _angle_section(run: LabRun) -> Section:
    result = run.result
    known = isinstance(result.observations.reference, KnownVector)
    rows: list[tuple[str, ...]] = []

    def row(name: str, held: Held) -> None:
        errors = attitude_errors(held, run.request.settings.conventions)
        rows.append((name, *_spreads(errors, known)))

    row("fitted, base", fitted(result.base))
    row("fitted, final", fitted(result.final))
    for split in result.splits:
        row(f"{split.name}, base", split.base)
        row(f"{split.name}, final", split.final)
    header = ("", "tool-face, deg", "inclination, deg", "|a|, mg") if known else ("", "|a|, mg")
    align = "l" + "r" * (len(header) - 1)
    note = "Largest / rms."
    if bends(result.final):
        note += " Inclination is compared after undoing the fixture error that was found."
    blocks: list[Block] = [Table("Errors on the positions", header, tuple(rows), align, note)]
    loop = result.loop
    if loop and loop.records:
        aside = attitude_errors(fitted(loop.final), run.request.settings.conventions)
        bad = {r.row for r in loop.records}
        rest = aside.take(np.array([k for k in range(len(aside.norm)) if k not in bad]))
        blocks.append(
            Table(
                "With the suspect records set aside",
                header,
                (("fitted, final", *_spreads(rest, known)),),
                align,
                "The same model fitted without them, on the other rows.",
            )
        )
    blocks += training_note(run)
    return Section("Angles and |a|" if known else "|a|", tuple(blocks))


def _spreads(errors: AttitudeErrors, known: bool) -> tuple[str, ...]:
    """Largest / rms of what the reference lets one compare."""
    values = (errors.tool_face, errors.inclination, errors.norm) if known else (errors.norm,)
    return tuple(spread((worst(v), rms(v))) for v in values)


def _order_words(fit: Fit) -> str:
    """Which order was taken for that of recording, and what follows from it."""
    by = "by their time" if "time" in fit.observations.context else "of the file, taken as recorded"
    reference = fit.observations.reference
    if not isinstance(reference, KnownVector):
        return by
    counts = (reference.inclination_setting.max() + 1, reference.tool_face_setting.max() + 1)
    return f"{by}: inclination set {counts[0]} times, tool-face {counts[1]} times"


def _bench_section(run: LabRun) -> Section:
    fit = run.result.final
    noise = setting_noise(fit)
    reading = reading_noise(fit)
    own = plus_minus(reading.own / MG, reading.own_sd / MG, "mg")
    rows = [("noise of a reading", own if reading.own > 0.0 else "none that it does not share")]
    for k, (name, sd) in enumerate(noise.items(), start=1):
        spread_sd = sd / DEG * float(fit.noise_sd[k])
        rows.append((name, f"{plus_minus(sd / DEG, spread_sd, 'deg')} scatter"))
    if reading.shared > 0.0:
        size = plus_minus(reading.shared / MG, reading.shared_sd / MG, "mg")
        after = f"forgotten in {reading.memory:.2g} positions"
        rows.append(("noise that neighbours share", f"{size}, {after}"))
    rows += [("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})")]
    if (kind := run.request.settings.population) is not None:
        rows += [("beside these rows", f"what {kind.devices} devices of its kind say (--fleet)")]
    rows += [("raw unit", run.raw.sentence)]
    rows += [("order of rows", _order_words(fit))]
    rows += [("condition number", f"{fit.condition:.0f}, parameters in typical sizes")]
    rows += [("left open", words) for words in fit.null_directions]
    rows += [("left out", text) for text in run.excluded]
    words = dial_words(run.result)
    return Section("The bench", (Facts(tuple(rows)), *((Text(words),) if words else ())))
