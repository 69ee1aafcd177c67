"""Curves of the lab report: the bench's dial, the angles' uncertainty, errors by position."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.uncertainty import angle_uncertainty
from imucalib.calibrators.lab.attitude import attitude_errors, rms
from imucalib.calibrators.lab.calibrate import gravity_of
from imucalib.calibrators.lab.dial import bends, dial_of
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector
from imucalib.loop.held_out import fitted
from imucalib.report.document import Plot, Section, Series, Table
from imucalib.units import DEG


def dial_section(run: LabRun) -> Section:
    """What the bench's inclination dial is off by; empty when no such error was found."""
    if not bends(run.result.final):
        return Section("The bench's inclination dial", ())
    at = np.linspace(0.0, np.pi / 2.0, 61)
    dial = dial_of(run.result, at)
    shift, half = dial.shift, dial.half
    band = Series("95 % band", at / DEG, shift, "band", shift - half, shift + half)
    line = Series("true inclination minus dial", at / DEG, shift, "line")
    caption = "What the bench's inclination dial is off by; no part of the sensor's calibration."
    plot = Plot("True inclination minus dial", "inclination (deg)", "deg", (band, line), caption)
    return Section("The bench's inclination dial", (plot,), brief=False)


def uncertainty_section(run: LabRun) -> Section:
    """The parameters' uncertainty carried to the angles; empty without known angles."""
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
    plots = (
        _half_width("Inclination, calibration only", x, inclination),
        _half_width("Tool-face, calibration only", x, tool_face),
    )
    chosen = [int(np.argmin(np.abs(x - v))) for v in (0.0, 30.0, 50.0, 80.0)]
    rows = tuple(
        (
            f"{x[k]:.0f}",
            f"{inclination[k]:.3f}",
            f"{curves[0].inclination_reading[k]:.3f}",
            f"{tool_face[k]:.3f}",
            f"{curves[0].tool_face_reading[k]:.3f}",
        )
        for k in chosen
    )
    table = Table(
        "Uncertainty carried to the angles (deg)",
        ("inclination", "inc., 95 %", "inc., 1 reading", "tool-face, 95 %", "tf, 1 reading"),
        rows,
        "rrrrr",
        "The frame's part (mounting, dial zero) is included; |a| cannot see it.",
    )
    return Section("Uncertainty of the angles", (table, *plots), brief=False)


def _half_width(title: str, x: Array, y: Array) -> Plot:
    caption = (
        "Half width of 95 % intervals, worst of four tool-faces; one reading's noise comes on top."
    )
    return Plot(title, "inclination (deg)", "deg", (Series("95 %", x, y, "line"),), caption)


def residual_plots(run: LabRun) -> tuple[Plot, ...]:
    """Errors of the fitted rows before and after the loop, first the one that gained most."""
    result = run.result
    gravity = gravity_of(result.observations)
    x = (result.used + 1).astype(np.float64)
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
    quantities.sort(key=lambda q: rms(q[3]) / max(rms(q[2]), 1e-12))
    for title, unit, old, new in quantities:
        series = (
            Series("base model", x, old, "points", names=names),
            Series("final model", x, new, "points", names=names),
        )
        caption = "Before and after the loop, fitted rows."
        plots.append(Plot(f"{title} by position", "row", unit, series, caption))
    return tuple(plots)
