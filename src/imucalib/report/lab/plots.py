"""Curves of the lab report: the bench's dial and the angles' uncertainty."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.uncertainty import angle_uncertainty
from imucalib.calibrators.lab.dial import bends, dial_of
from imucalib.calibrators.lab.errors import reading_noise
from imucalib.calibrators.lab.run import LabRun
from imucalib.core.references import KnownVector
from imucalib.report.document import Plot, Section, Series, Table
from imucalib.report.lab.card import within_a_circle
from imucalib.units import DEG


def dial_section(run: LabRun) -> Section:
    """What the bench's inclination dial is off by; empty when no such error was found."""
    if not bends(run.result.final):
        return Section("The bench's inclination dial", ())
    at = np.linspace(0.0, 90.0, 61)
    dial = dial_of(run.result, at)
    shift, half = dial.shift, dial.half
    band = Series("95 % band", at, shift, "band", shift - half, shift + half)
    line = Series("true inclination minus dial", at, shift, "line")
    caption = "What the bench's inclination dial is off by; no part of the sensor's calibration."
    plot = Plot(
        "True inclination minus dial",
        "inclination (deg)",
        "dial's error (deg)",
        (band, line),
        caption,
    )
    return Section("The bench's inclination dial", (plot,), brief=False)


def uncertainty_section(run: LabRun) -> Section:
    """The parameters' uncertainty carried to the angles; empty without known angles."""
    fit = run.result.final
    if not isinstance(fit.observations.reference, KnownVector):
        return Section("Uncertainty of the angles", ())
    at = np.radians(np.linspace(-85.0, 85.0, 69))
    sigma = reading_noise(fit).whole
    curves = [
        angle_uncertainty(fit, at, np.full(69, t), run.request.gravity, sigma)
        for t in np.radians([0, 90, 180, 270])
    ]
    inclination = np.max([c.inclination_95 for c in curves], axis=0)
    tool_face = np.max([c.tool_face_95 for c in curves], axis=0)
    x = run.request.settings.conventions.outside(at, np.zeros_like(at))[0]
    plots = (
        _half_width("Inclination, calibration only", x, inclination),
        _half_width("Tool-face, calibration only", x, tool_face),
    )
    chosen = [int(np.argmin(np.abs(at / DEG - v))) for v in (0.0, 30.0, 50.0, 80.0)]
    rows = tuple(
        (
            f"{x[k]:.0f}",
            within_a_circle(inclination[k], 90.0, 3),
            f"{curves[0].inclination_reading[k]:.3f}",
            within_a_circle(tool_face[k], 180.0, 3),
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
    return Plot(
        title, "inclination (deg)", "half width (deg)", (Series("95 %", x, y, "line"),), caption
    )
