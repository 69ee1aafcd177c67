"""Bias and scale against temperature, with their intervals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import STAGE, gyroscope_of
from imucalib.core.effect import Context
from imucalib.report.document import Section, Table
from imucalib.significant_digits import plus_minus
from imucalib.units import DEG, MG, STANDARD_GRAVITY

_NORMAL_95 = 1.96
_ROWS = 5


def temperature_section(calibration: Calibration) -> Section:
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
        return (gyro.bias + gyro.added(still, still, warm)) / DEG

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
