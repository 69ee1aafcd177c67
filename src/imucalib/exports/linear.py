"""What a form of few coefficients keeps of a calibration, and what it loses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import LINEAR, PASSING, Calibration
from imucalib.calibration.series import parts_of
from imucalib.core.effect import Context
from imucalib.core.sphere import even_directions
from imucalib.effects.forms import in_words
from imucalib.units import MG, STANDARD_GRAVITY


@dataclass(frozen=True)
class Sphere:
    """Readings (n, 3) m/s² of 1 g in every direction, at the ends and the middle of all ranges that
    were calibrated, times that mean nothing later at their end: force (n, 3) m/s², and the
    context."""

    force: Array
    reading: Array
    context: Context


def sphere_of(calibration: Calibration) -> Sphere:
    """What the calibrated sensor would read."""
    model, theta = calibration.model()
    one = STANDARD_GRAVITY * even_directions(600)
    needed = sorted({name for effect in model.effects for name in effect.needs})
    shares = (0.0, 0.5, 1.0) if needed else (0.5,)
    force = np.concatenate([one] * len(shares))
    known = {}
    for name in needed:
        low, high = calibration.valid[name]
        if name in PASSING and "clock" not in calibration.facts:
            low = high
        known[name] = np.repeat([low + s * (high - low) for s in shares], len(one))
    context = Context(len(force), known)
    return Sphere(force, model.predict(theta, force[:, None], context).reading[:, 0], context)


@dataclass(frozen=True)
class NearestLinear:
    """corrected = M raw + b (m/s²), and its mean and largest error (mg) against the calibration."""

    M: Array
    b: Array
    mean: float
    worst: float


def nearest_linear(calibration: Calibration) -> NearestLinear:
    """The linear part; with effects beyond it, the least-squares one over their ranges."""
    model, _ = calibration.model()
    if set(model.names) <= set(LINEAR):
        linear = calibration.matrices()
        return NearestLinear(linear.M, linear.b, 0.0, 0.0)
    seen = sphere_of(calibration)
    columns = np.column_stack([seen.reading, np.ones(len(seen.reading))])
    found = np.linalg.lstsq(columns, seen.force, rcond=None)[0]
    off = np.linalg.norm(columns @ found - seen.force, axis=1) / MG
    M, b = np.asarray(found[:3].T, np.float64), np.asarray(found[3], np.float64)
    return NearestLinear(M, b, float(off.mean()), float(off.max()))


def beyond_linear(calibration: Calibration) -> str:
    """The effects that a linear correction cannot carry, in words."""
    model, _ = calibration.model()
    return ", ".join(in_words(name) for name in model.names if name not in LINEAR)


def lost_linear(calibration: Calibration, linear: NearestLinear, more: str = "") -> tuple[str, ...]:
    """What a linear correction cannot carry, in words; more : of the form, after the sizes"""
    lost = lost_parts(calibration)
    if names := beyond_linear(calibration):
        words = (
            f"{names}: {linear.mean:.2f} mg on average over the sphere and the calibrated ranges, "
            f"{linear.worst:.2f} mg at most{more}"
        )
        lost = (words, *lost)
    return lost


def lost_parts(calibration: Calibration) -> tuple[str, ...]:
    """What is said where the calibration is in parts: a form holds one."""
    if not parts_of(calibration):
        return ()
    return ("the parts of the calibration: these are the coefficients of the whole",)
