"""A report shaped like the calibration of a tool-face accelerometer, with invented numbers."""

from __future__ import annotations

import numpy as np

from imucalib.report.document import Document, Facts, Plot, Section, Series, Table, Text

_EFFECTS = ("bias", "scale", "non-orthogonality", "mounting")
_UNITS = ("m/s²", "ppm", "arcmin", "arcmin")
_VALUES = (0.01342, -0.00731, 0.10218, 1240.0, -318.5, 77.25, 3.21, -0.84, 12.067, 4.4, -7.92, 0.3)
_SDS = (0.00012, 0.00013, 0.00011, 12.0, 11.5, 12.25, 0.04, 0.05, 0.043, 0.4, 0.41, 0.4)
_NAMES = ("b_x", "b_y", "b_z", "S_x", "S_y", "S_z", "γ_xy", "γ_xz", "γ_yz", "ε_x", "ε_y", "ε_z")
_DIGITS = (5, 5, 5, 0, 1, 2, 2, 2, 3, 1, 2, 1)


def demo_document() -> Document:
    """Every kind of block and mark once, at the sizes that a calibration of 48 positions has."""
    return Document(
        title="Accelerometer calibration: tool IMU-0417, 48 positions",
        verdict=Text(
            "The 12-parameter model fits to 0.42 mg rms (sensor noise 0.40 mg). Held-out"
            " inclination error falls from 0.81° to 0.06°. One effect is still missing:"
            " see the candidates.",
            "warning",
        ),
        sections=(_summary(), _parameters(), _errors(), _candidates(), _curve(), _record()),
        footer=(
            ("Input", "bench_2024-11-07.csv, 48 rows, 3 112 bytes"),
            ("sha256", "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"),
            ("Software", "imucal 0.1.0, numpy 2.4.6, scipy 1.17.1, Python 3.12.3, Linux x86_64"),
            ("Written", "2024-11-08T09:14:02Z, seed 20241108"),
        ),
    )


def _summary() -> Section:
    facts = (
        ("Positions", "48 used, 0 rejected; 12 held out by tool-face group"),
        ("Local gravity", "9.81234 m/s² (declared)"),
        ("Temperature", "21.3 to 22.9 °C"),
        ("Sensor noise", "0.40 mg per reading, from 10 s at rest in each position"),
        ("χ²/dof", "1.09 on 132 degrees of freedom (p = 0.22)"),
        ("Formula", "true = M·raw + b"),
    )
    warning = Text(
        "Position 31 lies 6.2 sd away from the model on y; it was kept. Refitting without it moves"
        " no parameter by more than 0.4 sd.",
        "warning",
    )
    return Section("Summary", (Facts(facts), warning))


def _parameters() -> Section:
    rows = tuple(
        (name, _EFFECTS[i // 3], f"{value:.{d}f}", f"{sd:.{d}f}", _UNITS[i // 3])
        for i, (name, value, sd, d) in enumerate(zip(_NAMES, _VALUES, _SDS, _DIGITS, strict=True))
    )
    table = Table(
        "Parameters with standard deviations",
        ("Parameter", "Effect", "Value", "sd", "Unit"),
        rows,
        "llrrl",
        note="Sensor model: reading = (1 + S)·Γ·R(ε)·true + b. The full covariance is in the YAML.",
        tones={11: "warning"},
    )
    return Section("Parameters", (table, Text("ε_z is not significant: |value| < 2 sd.")))


def _errors() -> Section:
    rng = np.random.default_rng(417)
    position = np.arange(1.0, 49.0)
    residuals = tuple(
        Series(
            f"residual {axis}",
            position,
            0.42 * rng.standard_normal(48) - (2.2 if axis == "y" else 0) * (position == 31),
            "points",
            names=tuple(f"position {k:.0f}, {axis}" for k in position),
        )
        for axis in "xyz"
    )
    places = np.arange(3.0)
    names = ("inclination", "tool face", "total field")
    before, after = np.array([0.81, 1.32, 0.55]), np.array([0.062, 0.11, 0.024])
    bars = (
        Series(
            label="before",
            x=places,
            y=before,
            mark="bars",
            low=0.88 * before,
            high=1.13 * before,
            names=names,
        ),
        Series(
            label="after",
            x=places,
            y=after,
            mark="bars",
            low=0.8 * after,
            high=1.25 * after,
            names=names,
        ),
    )
    return Section(
        "Errors before and after",
        (
            Plot("Held-out rms error", "", "rms error [°, %]", bars, "Whiskers: 95 % interval."),
            Plot(
                "Residuals per position",
                "position",
                "residual [mg]",
                residuals,
                "No trend with position; position 31 stands out on y.",
            ),
        ),
    )


def _candidates() -> Section:
    effects = (
        ("temperature of bias", "0.0004", "3.1 ± 0.8 µg/°C", "0.41", "yes"),
        ("drift", "0.0007", "12 ± 3 µg/h", "0.39", "temperature"),
        ("scale asymmetry", "0.031", "88 ± 41 ppm", "0.12", "yes"),
        ("second-order nonlinearity", "0.09", "14 ± 8 µg/g²", "0.05", "yes"),
        ("third-order nonlinearity", "0.22", "6 ± 5 µg/g³", "0.01", "scale"),
        ("cross-axis quadratic", "0.31", "9 ± 9 µg/g²", "-0.02", "yes"),
        ("hysteresis", "0.47", "11 ± 15 µg", "-0.04", "yes"),
        ("table axis wobble", "0.52", "0.3 ± 0.5 arcmin", "-0.06", "mounting"),
        ("inclination encoder", "0.61", "0.2 ± 0.4 arcmin", "-0.05", "yes"),
        ("tool-face encoder", "0.74", "0.1 ± 0.4 arcmin", "-0.08", "yes"),
        ("saturation", "—", "—", "—", "no"),
        ("clock skew", "—", "—", "—", "no"),
    )
    table = Table(
        "Effects that the model lacks, most likely first",
        ("Candidate", "p", "Size ± sd", "Held-out gain", "Identifiable"),
        effects,
        "lrrrl",
        note="p is corrected for 12 candidates. Gain: nats per held-out reading.",
        tones={0: "bad", 1: "warning"},
    )
    advice = Text(
        "Temperature and drift are aliases in this recording. Repeat the first six positions at the"
        " end, or at a second temperature, to tell them apart."
    )
    return Section("Candidates", (table, advice))


def _curve() -> Section:
    inclination = np.linspace(0.0, 90.0, 91)
    error = 0.02 + 0.09 * np.sin(np.radians(2 * inclination))
    half = 0.015 + 0.03 * (inclination / 90) ** 2
    tilt = np.arange(7.5, 90, 15)
    seen = 0.02 + 0.09 * np.sin(np.radians(2 * tilt)) + 0.02 * np.cos(7 * tilt)
    seconds = np.arange(20_000) / 100.0
    noise = 0.4 * np.random.default_rng(1).standard_normal(20_000)
    noise[9_000:10_500] = np.nan
    tau = np.logspace(-2, 3, 26)
    deviation = np.sqrt(1.6e-3 / tau + 1e-5 + 4e-8 * tau)
    outline = np.radians(np.arange(0, 361, 5))
    return Section(
        "Detail",
        (
            Plot(
                "Error over inclination",
                "inclination [°]",
                "inclination error [°]",
                (
                    Series("model ± 2 sd", inclination, error, "band", error - half, error + half),
                    Series("measured", tilt, seen, "points", seen - 0.02, seen + 0.02),
                ),
                "The remaining error is the bench's, largest at 45°.",
            ),
            Plot(
                "Noise at rest",
                "time [s]",
                "a_z − mean [mg]",
                (Series("a_z", seconds, noise, "line"),),
                "White, with a gap of 15 s at 90 s.",
            ),
            Plot(
                "Allan deviation",
                "log₁₀ of averaging time [s]",
                "deviation [mg]",
                (
                    Series("x", np.log10(tau), deviation, "line"),
                    Series("y", np.log10(tau), 1.4 * deviation, "step"),
                    Series("z", np.log10(tau), 0.6 * deviation, "line"),
                ),
                log_y=True,
            ),
            Plot(
                "Positions on the sphere, seen along z",
                "x",
                "y",
                (
                    Series("horizon", np.cos(outline), np.sin(outline), "line"),
                    Series("positions", np.cos(tilt) * 0.8, np.sin(tilt) * 0.8, "points"),
                ),
                equal=True,
            ),
        ),
        brief=False,
    )


def _record() -> Section:
    header = ("Position", *(f"{c} {q}" for q in ("raw", "true", "residual") for c in "xyz"))
    rng = np.random.default_rng(2)
    rows = tuple((str(k), *(f"{v:.5f}" for v in rng.normal(0, 6, 9))) for k in range(1, 13))
    table = Table("Readings in m/s²", header, rows, "r" * 10, note="First twelve positions.")
    return Section("Readings", (table,), brief=False)
