"""The reports of `imucal imu` and `imucal design --imu`, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.gyroscope import read_delay
from imucalib.calibrators.imu.plan import HandPlan
from imucalib.calibrators.imu.run import ImuRun, heading_drift
from imucalib.data import Data
from imucalib.report import sections
from imucalib.report.conditions import (
    compose_sessions_section,
    compose_temperature_section,
    power_up_worths,
)
from imucalib.report.render.document import (
    Card,
    Document,
    Facts,
    Plot,
    Section,
    Series,
    Table,
    Text,
    Use,
    Worth,
)
from imucalib.significant_digits import format_components, number, plus_minus, two_digits
from imucalib.units import DEG

_RATE = "rate = K (reading - bias - what effects add), in the accelerometer's frame."
_NAMES = tuple(f"{a}{b}" for a in "xyz" for b in "xyz")


def compose_imu_document(run: ImuRun) -> Document:
    """Everything that a reader of the calibration must know, the verdict first."""
    rest = (
        Section("Gyroscope", (_facts(run),)),
        Section("Parameters", (sections.parameter_table(run.calibration, _RATE),)),
        compose_sessions_section(run.details.between_sessions),
        compose_temperature_section(run.calibration),
        sections.compose_sensor_section(run.calibration),
        Section("Turns", (_turns(run),)),
    )
    title = f"IMU calibration of {run.outcome.provenance.input}"
    return sections.compose_calibration_document(title, run, _compose_card(run), rest=rest)


def _compose_card(run: ImuRun) -> Card:
    outcome = run.outcome
    median = two_digits(float(np.median(run.result.held_out.turns.final)))
    carried = sections.error_worth(outcome.error, "gravity after a turn", "turns")
    drift = f"± {two_digits(heading_drift(run.result.fit))} deg"
    how = "95 %, worst axis, beside what the bias does"
    left_out = "rests" if run.details.between_sessions is None else "power-ups"
    good = [
        Worth(carried.quantity, carried.value, carried.detail, f"median {median} deg"),
        Worth("heading after 360 deg", drift, how),
        sections.error_worth(outcome.errors[1], "size of a force", left_out),
        *power_up_worths(run.details.between_sessions),
        *_delay(run),
    ]
    if run.request.gravity_assumed:
        good.append(sections.gravity_worth(run.request.gravity))
    uses = (sections.CORRECT, *_for_kalibr(run))
    return sections.compose_card(outcome, tuple(good), uses=uses, picture=_picture(run))


def _delay(run: ImuRun) -> tuple[Worth, ...]:
    """What is to be taken from the gyroscope's stamps, where it is more than chance."""
    told = read_delay(run.calibration)
    if told is None:
        return ()
    late, sd = 1e3 * told[0], 1e3 * told[1]
    side, deed = ("behind", "subtract") if late > 0.0 else ("ahead of", "add")
    what = f"{side} the accelerometer: {deed} {abs(late):.2g} ms where stamps count"
    return (Worth("gyroscope's delay", plus_minus(abs(late), sd, "ms"), what),)


def _for_kalibr(run: ImuRun) -> tuple[Use, ...]:
    """Its file, with the noise of the same recording, where it carries the calibration."""
    noise = "{folder}/noise.yaml"
    measured = Use("Measure its noise", ("noise", "{input}", "--to", "kalibr", "-o", noise))
    purpose = "With it, for Kalibr and OpenVINS"
    made = sections.propose_export(run.calibration, purpose, "kalibr", "kalibr.yaml")
    return (measured, *(replace(m, words=(*m.words, "--noise", noise)) for m in made)) * bool(made)


def _facts(run: ImuRun) -> Facts:
    imu, noise = run.details.imu, run.details.imu.gyroscope_noise
    axes = zip(noise.white_deg_per_s_per_root_hz, noise.white_sd, strict=True)
    white = ", ".join(plus_minus(v, sd, "") if sd else f"at most {v:.3g}" for v, sd in axes)
    late, late_sd = 1e3 * imu.gyroscope_late_s.value, 1e3 * imu.gyroscope_late_s.sd
    least = max(noise.bias_instability_deg_per_s, default=float("nan"))
    word = "at most " if noise.upper_limit else ""
    turns = f"{imu.turns} between {imu.rests} rests; {len(imu.turns_left_out)} left out"
    delay = f"{plus_minus(late, late_sd, 'ms')} behind the accelerometer, by the moving "
    rows = (
        ("frame", imu.frame),
        ("white noise x, y, z", f"{white} deg/s/√Hz, from a rest of {noise.rest_s:.0f} s"),
        ("bias instability", f"{word}{least:.2g} deg/s"),
        ("gyroscope's delay", f"{delay}accelerometer; nothing is corrected by it"),
        ("turns", turns),
    )
    return Facts(rows)


def _picture(run: ImuRun) -> Plot:
    """By how much gravity is off after every turn, as read and corrected."""
    held, path = run.result.held_out.turns, run.result.imu.turns.spans[2] / DEG
    shown = (("as read", held.raw), ("with gains", held.base), ("corrected", held.final))
    series = tuple(Series(name, path, off, "points") for name, off in shown)
    caption = (
        "One point a turn, carried over by a model that was searched for and fitted without it."
    )
    labels = ("Gravity after a turn", "path of the turn (deg)", "gravity off by (deg)")
    return Plot(*labels, series, caption, log_y=True)


def _turns(run: ImuRun) -> Table:
    log, held, fit = run.result.imu.turns, run.result.held_out.turns, run.result.fit
    spans = zip(log.turns, log.spans[2], held.raw, held.base, held.final, fit.weight, strict=True)
    rows = []
    for turn, path, *off, weight in spans:
        where = (str(turn.rest + 1), f"{turn.t[0]:.1f}", f"{path / DEG:.0f}")
        weights = map(number, (weight, float(fit.rest_weight[turn.rest + 1])))
        rows.append((*where, *map(number, off, (2, 3, 3)), *weights))
    header = ("turn", "from, s", "path, deg", "as read", "base", "final", "weight", "of rest")
    note = (
        "deg by which gravity is off after a turn that took no part; weights in the fit, of the "
        "turn (1.5 at most) and of the rest that ends it (1.75)."
    )
    return Table("Turns held out", header, tuple(rows), "r" * len(header), note)


def compose_hand_plan_document(plan: HandPlan) -> Document:
    """The turns in their order, and what is known of the gains after them."""
    count, added = len(plan.turns), plan.before is not None
    scale, cross = _worst(plan)
    words = f"{count} more turns" if added else f"{count} turns of 135 deg, {count + 1} rests"
    verdict = Text(
        f"{words}: scales to {scale:.2g} %, cross terms to {cross:.2g} % (one standard deviation).",
        "bad" if plan.open_gains else "ok",
    )
    rows = tuple(
        (str(k), turn.axis, format_components(turn.up), f"{100.0 * turn.after:.2g}")
        for k, turn in enumerate(plan.turns, start=1)
    )
    note = (
        "135 deg each, by hand, about the sensor's own axis, under the gyroscope's range, with two "
        "seconds of rest on something hard before and after. Gravity: what the accelerometer "
        "reads, in g."
    )
    header = ("turn", "about", "gravity before", "sd of a gain after, %")
    turns = Table("", header, rows, "rllr", note)
    known = [plan.sd] if plan.before is None else [plan.before, plan.sd]
    sds = tuple((name, *(f"{100.0 * sd[k]:.2g}" for sd in known)) for k, name in enumerate(_NAMES))
    gains = Table("", ("gain", *["sd now, %"] * added, "sd then, %"), sds, "l" + "r" * len(known))
    stay = Text.paragraphs((f"These stay open: {words}." for words in plan.open_gains), "bad")
    parts = (Section("Turns", (turns,)), Section("Gains", (*stay, gains)))
    return Document("Turns to add" if added else "Turns to take", verdict, parts)


class TurnToTake(Data):
    """A turn of 135 deg by hand."""

    about: Annotated[str, "Signed axis of the sensor."]
    gravity_before: Annotated[Array, "What its accelerometer reads, g."]
    sd_after: Annotated[float, "Mean sd of the gains once it is taken."]


class TurnPlan(Data, name="turns/1"):
    """Turns to take, in their order, and what they tell of a gyroscope's gains."""

    turns: tuple[TurnToTake, ...]
    sd: Annotated[Mapping[str, float], "Of each gain after them."]
    sd_before: Annotated[Mapping[str, float] | None, "The same before them, of turns to add."]
    open: Annotated[tuple[str, ...], "What they leave open."]


def describe_hand_plan(plan: HandPlan) -> TurnPlan:
    """The same for machines."""
    before, keys = plan.before, "about=axis gravity_before=up sd_after=after"
    return TurnPlan(
        turns=tuple(TurnToTake.of(one, keys) for one in plan.turns),
        sd=dict(zip(_NAMES, plan.sd, strict=True)),
        sd_before=None if before is None else dict(zip(_NAMES, before, strict=True)),
        open=tuple(plan.open_gains),
    )


def _worst(plan: HandPlan) -> tuple[float, float]:
    """%, of the scales and of the cross terms."""
    sd = 100.0 * plan.sd.reshape(3, 3)
    own = np.eye(3, dtype=bool)
    return float(sd[own].max()), float(sd[~own].max())
