"""A report as a calibration has it, with invented numbers: every kind of block and mark once."""

from __future__ import annotations

import numpy as np

from imucalib.report.document import Document, Facts, Plot, Section, Series, Table, Text

_SHORT = Table(
    "Parameters with standard deviations",
    ("Parameter", "Effect", "Value", "sd", "Unit"),
    (
        ("b_x", "bias", "0.01342", "0.00012", "m/s²"),
        ("S_x", "scale", "1240", "12", "ppm"),
        ("γ_yz", "non-orthogonality", "12.067", "0.043", "arcmin"),
        ("ε_z", "mounting", "0.3", "0.4", "arcmin"),
    ),
    "llrrl",
    note="Sensor model: reading = (1 + S)·Γ·R(ε)·true + b. The full covariance is in the YAML.",
    tones={1: "bad", 3: "warning"},
)


def demo_document() -> Document:
    """At the sizes that a calibration of 48 positions has."""
    facts = (
        ("Local gravity", "9.81234 m/s² (declared)"),
        ("χ²/dof", "1.09 on 132 degrees of freedom (p = 0.22)"),
        ("Formula", "true = M·raw + b"),
    )
    warning = Text("Position 31 lies 6.2 sd away from the model on y; it was kept.", "warning")
    return Document(
        title="Accelerometer calibration: tool IMU-0417, 48 positions",
        verdict=Text(
            "The 12-parameter model fits to 0.42 mg rms; the error falls from 0.81° to 0.06°.",
            "warning",
        ),
        sections=(
            Section("Summary", (Facts(facts), warning)),
            Section("Parameters", (_SHORT, Text("ε_z is not significant: |value| < 2 sd."))),
            Section("Errors before and after", (_bars(), _points())),
            Section("Detail", _curves(), brief=False),
            Section("Readings", (_readings(),), brief=False),
        ),
        footer=(
            ("Input", "bench_2024-11-07.csv, 48 rows, 3 112 bytes"),
            ("sha256", "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"),
        ),
    )


def _bars() -> Plot:
    names = ("inclination", "tool face", "total field")
    series = tuple(
        Series(label, np.arange(3.0), y, "bars", 0.8 * y, 1.2 * y, names)
        for label, y in (
            ("before", np.array([0.81, 1.32, 0.55])),
            ("after", np.array([0.062, 0.11, 0.024])),
        )
    )
    return Plot("Held-out rms error", "", "rms error [°, %]", series, "Whiskers: 95 % interval.")


def _points() -> Plot:
    rng, position = np.random.default_rng(417), np.arange(1.0, 49.0)
    series = tuple(
        Series(
            f"residual {axis}",
            position,
            0.42 * rng.standard_normal(48),
            "points",
            names=tuple(f"position {k:.0f}, {axis}" for k in position),
        )
        for axis in "xyz"
    )
    return Plot("Residuals per position", "position", "residual [mg]", series, "No trend.")


def _curves() -> tuple[Plot, ...]:
    """A band, a line of 20,000 points with a gap, a step on a logarithmic axis, equal scales."""
    tilt = np.linspace(0.0, 90.0, 91)
    error = 0.02 + 0.09 * np.sin(np.radians(2 * tilt))
    noise = 0.4 * np.random.default_rng(1).standard_normal(20_000)
    noise[9_000:10_500] = np.nan
    tau = np.logspace(-2, 3, 26)
    deviation = np.sqrt(1.6e-3 / tau + 1e-5 + 4e-8 * tau)
    outline = np.radians(np.arange(0, 361, 5))
    band = Series("model ± 2 sd", tilt, error, "band", error - 0.02, error + 0.02)
    trace = Series("a_z", np.arange(20_000) / 100.0, noise, "line")
    steps = Series("x", np.log10(tau), deviation, "step")
    horizon = Series("horizon", np.cos(outline), np.sin(outline), "line")
    return (
        Plot("Error over inclination", "inclination [°]", "error [°]", (band,), "Largest at 45°."),
        Plot("Noise at rest", "time [s]", "a_z − mean [mg]", (trace,), "White, with a gap."),
        Plot("Allan deviation", "log₁₀ of time [s]", "deviation [mg]", (steps,), log_y=True),
        Plot("Positions on the sphere", "x", "y", (horizon,), equal=True),
    )


def _readings() -> Table:
    header = ("Position", *(f"{c} {q}" for q in ("raw", "true", "residual") for c in "xyz"))
    rng = np.random.default_rng(2)
    rows = tuple((str(k), *(f"{v:.5f}" for v in rng.normal(0, 6, 9))) for k in range(1, 13))
    return Table("Readings in m/s²", header, rows, "r" * 10, note="First twelve positions.")
