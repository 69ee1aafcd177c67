"""Parameters under other conditions: after another power-up, and against temperature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import STAGE, gyroscope_of
from imucalib.calibrators.sessions import BetweenSessions, ScatterFacts
from imucalib.core.effect import Context
from imucalib.report.render.document import Plot, Section, Series, Table, Text, Worth
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG, MG, STANDARD_GRAVITY

_NORMAL_95 = 1.96
_ROWS = 5


def power_up_worths(sessions: BetweenSessions | None) -> list[Worth]:
    """How far what changes between power-ups lets a calibration carry."""
    found = dict[str, Worth]()
    every = sorted(sessions.next_power_up, key=lambda p: p.half_of_95) if sessions else ()
    for p in every:
        count = len(sessions.sessions) if sessions else 0
        mean = f"their mean ± {1.96 * p.sd_of_mean:.2g}"
        detail = f"95 %, worst axis, from {count} sessions; {mean}"
        size = f"± {p.half_of_95:.2g} {p.unit}"
        found[p.effect] = Worth(f"{p.effect} after a power-up", size, detail)
    return list(found.values())


def compose_sessions_section(sessions: BetweenSessions | None) -> Section:
    """What changes between power-ups, and the parameters after the next; empty of one session."""
    if sessions is None:
        return Section("Sessions", ())
    count = len(sessions.sessions)
    rows = tuple(
        (
            p.parameter.replace("_", " "),
            plus_minus(p.value, p.sd_of_mean, p.unit),
            plus_minus(p.value, p.sd_next_power_up, p.unit),
            f"{p.value - p.half_of_95:.3g} to {p.value + p.half_of_95:.3g}",
        )
        for p in sessions.next_power_up
    )
    header = ("", f"mean of {count} power-ups", "next power-up", "95 %")
    note = (
        "The calibration states the mean of the power-ups. What changes between them is in the sd "
        "of the next one: used after switching off, it is good to that."
    )
    words = [
        Text(
            f"Between {count} power-ups the {one.effect} scatters by {one.sd:.2g} {one.unit} an "
            f"axis (95 %: {one.low_95:.2g} to {one.high_95:.2g})."
        )
        for one in sessions.scatter
    ]
    table = Table("After the next power-up", header, rows, "lrrr", note)
    plots = (_session_plot(one, sessions.sessions) for one in sessions.scatter)
    return Section("Sessions", (*words, table, *plots))


def _session_plot(one: ScatterFacts, names: tuple[str, ...]) -> Plot:
    at = np.arange(1.0, len(names) + 1.0)
    axes = enumerate(zip("xyz", one.offsets.T, one.offsets_sd.T, strict=True))
    series = tuple(
        Series.from_half(axis, at + 0.08 * (k - 1), off, sd, "points", names)
        for k, (axis, off, sd) in axes
    )
    title, y_label = f"{one.effect.capitalize()} of each session", f"{one.effect} less the mean"
    caption = "Offset of each power-up from the mean, with its sd."
    return Plot(title, "session", f"{y_label}, {one.unit}", series, caption)


def compose_temperature_section(calibration: Calibration) -> Section:
    """Empty where no effect follows the temperature."""
    low, high = calibration.valid.get("temperature", (0.0, 0.0))
    warm = np.linspace(low, high, _ROWS)
    model = calibration.model()[0]
    follows = any(name.startswith("temperature") for e in model.effects for name in e.needs)
    gyro = gyroscope_of(calibration)
    turns = gyro is not None and any("temperature" in e.needs for e, _, _ in gyro.laws)
    if high <= low or not (follows or turns):
        return Section("Against temperature", ())
    tables = [_force_table(calibration, warm, what) for what in ("bias", "scale") if follows]
    tables += [_rate_table(calibration, warm)] if turns else []
    return Section("Against temperature", tuple(tables))


def _force_table(calibration: Calibration, warm: Array, what: str) -> Table:
    """Of the accelerometer: its reading without a force, or what it makes of one g an axis."""
    model, theta = calibration.model()
    known = calibration.context(warm.size).covariates
    here = {n: warm for n in known if n.startswith("temperature")}
    context, nothing = Context(warm.size, {**known, **here}), np.zeros((warm.size, 1, 3))
    still = model.predict(theta, nothing, context)
    value, slope = still.reading[:, 0] / MG, still.d_theta[:, 0] / MG
    if what == "scale":
        for axis in range(3):
            moved = model.predict(theta, nothing + STANDARD_GRAVITY * np.eye(3)[axis], context)
            away = moved.reading - still.reading, moved.d_theta - still.d_theta
            value[:, axis] = 100.0 * (away[0][:, 0, axis] / STANDARD_GRAVITY - 1.0)
            slope[:, axis] = 100.0 * away[1][:, 0, axis] / STANDARD_GRAVITY
    spread = np.einsum("nip,pq,niq->ni", slope, calibration.covariance_of(model), slope)
    unit = "mg" if what == "bias" else "%"
    note = "± 95 %, of the calibration; a power-up's own bias comes beside it."
    return _table(f"Accelerometer's {what}", warm, value, np.sqrt(spread), unit, note)


def _rate_table(calibration: Calibration, warm: Array) -> Table:
    """Of the gyroscope: its reading without a rate, as of the last power-up."""
    still = np.zeros((warm.size, 3))

    def read(values: Array) -> Array:
        each = zip(calibration.parameters, values, strict=True)
        gyro = gyroscope_of(
            replace(calibration, parameters=tuple(replace(p, value=float(v)) for p, v in each))
        )
        assert gyro is not None
        return (gyro.bias + gyro.evaluate_laws(still, still, warm)) / DEG

    here = np.array([p.value for p in calibration.parameters])
    own = [k for k, p in enumerate(calibration.parameters) if p.stage == STAGE]
    value, unit = read(here), np.eye(here.size)
    slope = np.stack([read(here + unit[k]) - value for k in own], axis=2)  # linear in all of them
    covariance = calibration.covariance[np.ix_(own, own)]
    sd = np.sqrt(np.einsum("nip,pq,niq->ni", slope, covariance, slope))
    note = "± 95 %, of the bias at the last rest and of its law."
    return _table("Gyroscope's bias", warm, value, sd, "deg/s", note)


def _table(title: str, warm: Array, value: Array, sd: Array, unit: str, note: str) -> Table:
    half = _NORMAL_95 * sd
    rows = tuple(
        (f"{t:.1f}", *(plus_minus(float(v), float(h), "") for v, h in zip(*own, strict=True)))
        for t, *own in zip(warm, value, half, strict=True)
    )
    return Table(f"{title}, {unit}", ("°C", "x", "y", "z"), rows, "rrrr", note)
