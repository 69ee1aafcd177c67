"""The report of `imucal lab`, as data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucalib.attitude import AttitudeErrors, attitude_errors, rms, worst
from imucalib.calibration import Calibration
from imucalib.calibrators.lab import gravity_of, setting_noise
from imucalib.calibrators.lab_advice import curve_words, fixture_curve
from imucalib.calibrators.lab_calibration import lab_calibration
from imucalib.calibrators.lab_run import LabRun
from imucalib.held_out import fitted
from imucalib.references import KnownVector
from imucalib.report.document import (
    Block,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Tone,
)
from imucalib.report.lab_tables import iscwsa_table, position_table, published_table, training_note
from imucalib.report.loop import advice_section, candidate_section, loop_section
from imucalib.significant_digits import plus_minus, spread, with_sd
from imucalib.uncertainty import angle_uncertainty
from imucalib.units import DEG, MG

Array = NDArray[np.float64]


def lab_document(run: LabRun) -> Document:
    """Everything that a reader of the calibration must know, headline first."""
    calibration = lab_calibration(run)
    outcome = run.outcome
    sections = [
        loop_section(outcome),
        _angle_section(run),
        _parameter_section(run),
        _bench_section(run),
        _fixture_section(run),
        advice_section(outcome),
        _sensor_section(run, calibration),
        _uncertainty_section(run),
        Section("Positions", (position_table(run), *_residual_plots(run)), brief=False),
    ]
    if outcome.loop:
        sections.append(candidate_section(outcome.loop))
    if run.request.settings.objective == "paper":
        sections.append(Section("As published", (published_table(run),), brief=False))
    return Document(
        f"Lab calibration of {outcome.provenance.path}",
        _verdict(run),
        tuple(s for s in sections if s.blocks),
        _footer(run),
    )


def _verdict(run: LabRun) -> Text:
    outcome = run.outcome
    error = outcome.error
    tone: Tone = {"ok": "ok", "marginal": "warning", "failed": "bad"}[outcome.status]  # type: ignore[assignment]
    head = (
        f"Held-out error {error.held_out.raw:.2f} raw, {error.held_out.base:.2f} base, "
        f"{error.held_out.final:.2f} {error.unit} rms final (noise floor {error.floor:.2f})."
    )
    broken = [
        f"{x.name}: {x.value:.3g} {x.unit} exceeds {x.limit:g}" for x in outcome.limits if x.broken
    ]
    why = [f"{r[0].upper()}{r[1:]}" for r in outcome.reasons if not r.startswith("record errors")]
    text = " ".join([head, *(f"{t}." for t in (*broken, *outcome.undecided, *why))])
    return Text(text, tone)


def _parameter_section(run: LabRun) -> Section:
    fit = run.result.final
    effect_of = {}
    slices = fit.model.slices(fit.observations.context)
    for name, part in slices.items():
        effect_of |= dict.fromkeys(range(part.start, part.stop), name)
    rows = tuple(
        (p.name, effect_of[k], *with_sd(float(v), float(s)), p.unit)
        for k, (p, v, s) in enumerate(zip(fit.parameters, fit.theta, fit.sd, strict=True))
    )
    factor = fit.noise.factor
    note = (
        f"sd with the noise as estimated ({factor:.2f} times the declared or assumed one); with the "
        f"declared noise taken at its word, divide by {factor:.2f}."
    )
    table = Table("Parameters", ("parameter", "effect", "value", "sd", "unit"), rows, "llrrl", note)
    return Section("Parameters", (table,))


def _angle_section(run: LabRun) -> Section:
    result = run.result
    known = isinstance(result.observations.reference, KnownVector)
    gravity = gravity_of(result.observations)
    rows: list[tuple[str, ...]] = []

    def row(name: str, errors: AttitudeErrors) -> None:
        rows.append((name, *_spreads(errors, known)))

    row("fitted, base", attitude_errors(fitted(result.base), gravity))
    row("fitted, final", attitude_errors(fitted(result.final), gravity))
    for split in result.splits:
        row(f"{split.name}, base", attitude_errors(split.base, gravity))
        row(f"{split.name}, final", attitude_errors(split.final, gravity))
    header = ("", "tool-face, deg", "inclination, deg", "|a|, mg") if known else ("", "|a|, mg")
    align = "l" + "r" * (len(header) - 1)
    note = "Largest / rms."
    if curve_words(result.final):
        note += " Inclination is compared after undoing the fixture error that was found."
    blocks: list[Block] = [Table("Errors on the positions", header, tuple(rows), align, note)]
    loop = result.loop
    if loop and loop.records:
        aside = attitude_errors(fitted(loop.final), gravity)
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


def _bench_section(run: LabRun) -> Section:
    fit = run.result.final
    noise = setting_noise(fit.noise)
    sigma = fit.noise.factor * float(np.median(fit.at.sigma)) / MG
    rows = [("noise of a reading", plus_minus(sigma, sigma * float(fit.noise_sd[0]), "mg"))]
    for k, (name, sd) in enumerate(noise.items(), start=1):
        spread_sd = sd / DEG * float(fit.noise_sd[k])
        rows.append((name, f"{plus_minus(sd / DEG, spread_sd, 'deg')} scatter"))
    rows += [("local gravity", f"{run.request.gravity:.5f} m/s² ({run.request.gravity_source})")]
    rows += [("raw unit", run.raw.sentence)]
    rows += [("left out", text) for text in run.excluded]
    words = curve_words(fit)
    return Section("The bench", (Facts(tuple(rows)), *((Text(words),) if words else ())))


def _fixture_section(run: LabRun) -> Section:
    fit = run.result.final
    if not curve_words(fit):
        return Section("The bench's inclination dial", ())
    at = np.linspace(0.0, np.pi / 2.0, 61)
    shift, _, half = fixture_curve(fit, at)
    band = Series("95 % band", at / DEG, shift, "band", shift - half, shift + half)
    line = Series("true inclination minus dial", at / DEG, shift, "line")
    caption = "What the bench's inclination dial is off by; no part of the sensor's calibration."
    plot = Plot("True inclination minus dial", "inclination (deg)", "deg", (band, line), caption)
    return Section("The bench's inclination dial", (plot,), brief=False)


def _sensor_section(run: LabRun, calibration: Calibration) -> Section:
    linear = calibration.matrices()
    rows = []
    for k, letter in enumerate("xyz"):
        m = "  ".join(f"{v:+.6f}" for v in linear.M[k])
        rows.append(
            (
                letter,
                m,
                f"{linear.b[k] / MG:+.3f}",
                *with_sd(float(linear.scale[k]), float(linear.scale_sd[k])),
            )
        )
    table = Table(
        "corrected = M raw + b",
        ("axis", "M", "b, mg", "scale", "sd"),
        tuple(rows),
        "llrrr",
        "Scale: sensitivity of each axis, free of the frame.",
    )
    angles = Facts(
        tuple(
            (f"angle {pair}", plus_minus(float(a), float(s), "deg"))
            for pair, a, s in zip(("xy", "xz", "yz"), linear.angle, linear.angle_sd, strict=True)
        )
    )
    return Section("The sensor", (table, angles, iscwsa_table(calibration, linear)), brief=False)


def _uncertainty_section(run: LabRun) -> Section:
    fit = run.result.final
    if not isinstance(fit.observations.reference, KnownVector):
        return Section("Uncertainty of the angles", ())
    at = np.radians(np.linspace(-85.0, 85.0, 69))
    sigma = fit.noise.factor * float(np.median(fit.at.sigma))
    curves = [
        angle_uncertainty(fit, at, np.full(69, t), run.request.gravity, sigma)
        for t in np.radians([0, 90, 180, 270])
    ]
    inclination = np.max([c.inclination_95 for c in curves], axis=0)
    tool_face = np.max([c.tool_face_95 for c in curves], axis=0)
    x = at / DEG
    caption = (
        "Half width of 95 % intervals, worst of four tool-faces; one reading's noise comes on top."
    )
    plots = (
        Plot(
            "Inclination, calibration only",
            "inclination (deg)",
            "deg",
            (Series("95 %", x, inclination, "line"),),
            caption,
        ),
        Plot(
            "Tool-face, calibration only",
            "inclination (deg)",
            "deg",
            (Series("95 %", x, tool_face, "line"),),
            caption,
        ),
    )
    chosen = [int(np.argmin(np.abs(x - v))) for v in (0.0, 30.0, 50.0, 80.0)]
    rows = tuple(
        (f"{x[k]:.0f}", f"{inclination[k]:.3f}", f"{curves[0].inclination_reading[k]:.3f}",
         f"{tool_face[k]:.3f}", f"{curves[0].tool_face_reading[k]:.3f}")
        for k in chosen
    )  # fmt: skip
    table = Table(
        "Uncertainty carried to the angles (deg)",
        ("inclination", "inc., 95 %", "inc., 1 reading", "tool-face, 95 %", "tf, 1 reading"),
        rows, "rrrrr", "The frame's part (mounting, dial zero) is included; |a| cannot see it.",
    )  # fmt: skip
    return Section("Uncertainty of the angles", (table, *plots), brief=False)


def _residual_plots(run: LabRun) -> tuple[Plot, ...]:
    result = run.result
    gravity = gravity_of(result.observations)
    x = result.used + 1.0
    before = attitude_errors(fitted(result.base), gravity)
    after = attitude_errors(fitted(result.final), gravity)
    names = result.final.observations.label
    plots = []
    quantities = [("|a| error", "mg", before.norm, after.norm)]
    if isinstance(result.observations.reference, KnownVector):
        quantities += [
            ("Inclination error", "deg", before.inclination, after.inclination),
            ("Tool-face error", "deg", before.tool_face, after.tool_face),
        ]
    for title, unit, old, new in quantities:
        series = (
            Series("base model", x, old, "points", names=names),
            Series("final model", x, new, "points", names=names),
        )
        plots.append(
            Plot(
                f"{title} by position",
                "row",
                unit,
                series,
                "Before and after the loop, fitted rows.",
            )
        )
    return tuple(plots)


def _footer(run: LabRun) -> tuple[tuple[str, str], ...]:
    origin = run.outcome.provenance
    return (
        ("input", f"{origin.path}, sha256 {origin.sha256[:16]}…"),
        ("seed", str(origin.seed)),
        ("versions", ", ".join(f"{k} {v}" for k, v in origin.versions.items())),
        ("time", origin.time),
    )
