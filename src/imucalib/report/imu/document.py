"""The report of `imucal imu`, as data."""

from __future__ import annotations

import numpy as np

from imucalib.calibration.gyroscope import STAGE
from imucalib.calibrators.imu.run import ImuRun, heading_drift
from imucalib.report.card import card_of, error_worth
from imucalib.report.document import Card, Document, Facts, Section, Table, Worth
from imucalib.report.loop import TERMS, advice_section, floor_words, gain_plot, loop_section
from imucalib.report.sections import closing_sections, parameter_table, sensor_section, verdict
from imucalib.significant_digits import plus_minus, two_digits, with_sd
from imucalib.units import DEG


def imu_document(run: ImuRun) -> Document:
    """Everything that a reader of the calibration must know, headline first."""
    outcome, error = run.outcome, run.outcome.error
    head = (
        f"Held-out gravity over a turn {error.held_out.raw:.2f} as read, {error.held_out.base:.2f} "
        f"with gains, {error.held_out.final:.2f} deg rms final {floor_words(error)}."
    )
    sections = [
        loop_section(outcome),
        Section("Residual before and after", gain_plot(outcome.findings), brief=False),
        Section("Gyroscope", (_gains(run), _facts(run))),
        Section("Parameters", (parameter_table(run.calibration, ""),), brief=False),
        advice_section(outcome),
        sensor_section(run.calibration),
        Section("Turns", (_turns(run),), brief=False),
        *closing_sections(outcome),
    ]
    return Document(
        f"IMU calibration of {outcome.provenance.path}",
        verdict(outcome, head),
        tuple(s for s in sections if s.blocks),
        outcome.provenance.footer,
        _card(run),
        TERMS,
    )


def _card(run: ImuRun) -> Card:
    outcome, held = run.outcome, run.result.held_out
    median = two_digits(float(np.median(held.final)))
    carried = error_worth(outcome.error, "gravity after a turn", "turns")
    drift = heading_drift(run.result.fit)
    good = (
        Worth(carried.quantity, carried.value, f"{carried.detail}; median {median} deg"),
        Worth(
            "heading after 360 deg", f"drifts by at most {two_digits(drift)} deg",
            "95 %, about the worst axis, beside what the bias does meanwhile",
        ),
        error_worth(outcome.errors[1], "size of a force", "rests"),
    )  # fmt: skip
    return card_of(outcome, good)


def _gains(run: ImuRun) -> Table:
    """K, in the accelerometer's frame."""
    values = [p for p in run.calibration.parameters if p.stage == STAGE]
    rows = tuple((p.name, *with_sd(p.value, p.sd), p.unit) for p in values)
    note = "ω = K (reading - bias - what effects add), in the accelerometer's frame."
    return Table("Gyroscope", ("parameter", "value", "sd", "unit"), rows, "lrrl", note)


def _facts(run: ImuRun) -> Facts:
    imu = run.details["imu"]
    noise = imu["gyroscope_noise"]
    white = ", ".join(
        plus_minus(v, (high - low) / 3.92, "")
        for v, low, high in zip(
            noise["white_deg_per_s_per_root_hz"], noise["white_95_low"], noise["white_95_high"],
            strict=True,
        )
    )  # fmt: skip
    late, late_sd = (1e3 * imu["gyroscope_late_s"][name] for name in ("value", "sd"))
    least = max(noise["bias_instability_at_most_deg_per_s"])
    word = "at most " if noise["upper_limit"] else ""
    return Facts(
        (
            ("frame", imu["frame"]),
            ("white noise x, y, z", f"{white} deg/s/√Hz, from a rest of {noise['rest_s']:.0f} s"),
            ("bias instability", f"{word}{least:.2g} deg/s"),
            ("gyroscope's delay", f"{plus_minus(late, late_sd, 'ms')} behind the accelerometer, "
                                  "by the moving accelerometer; nothing is corrected by it"),
            ("turns", f"{imu['turns']} between {imu['rests']} rests; "
                      f"{len(imu['turns_left_out'])} left out"),
        )
    )  # fmt: skip


def _turns(run: ImuRun) -> Table:
    log, held, weight = run.result.imu.turns, run.result.held_out, run.result.fit.weight
    rows = tuple(
        (str(turn.rest + 1), f"{turn.t[0]:.1f}", f"{path / DEG:.0f}", f"{raw:.2f}",
         f"{base:.3f}", f"{final:.3f}", f"{w:.2f}")
        for turn, path, raw, base, final, w in zip(
            log.turns, log.spans[2], held.raw, held.base, held.final, weight, strict=True
        )
    )  # fmt: skip
    header = ("turn", "from, s", "path, deg", "as read", "base", "final", "weight")
    note = (
        "deg by which gravity is off after a turn that took no part; weight in the fit, 1.5 most."
    )
    return Table("Turns held out", header, rows, "rrrrrrr", note)
