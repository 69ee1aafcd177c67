"""What a form of few coefficients keeps of a calibration, and what it loses: the nearest matrix and
vector, or the nearest scale and offset of each axis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import LINEAR, PASSING, Calibration
from imucalib.calibration.series import parts_of
from imucalib.core.effect import Context
from imucalib.core.sphere import CELLS, cell_of, even_directions
from imucalib.effects.forms import in_words
from imucalib.errors import UsageError
from imucalib.estimators.levenberg_marquardt import minimise
from imucalib.units import DEG, MG, STANDARD_GRAVITY

#: The catalogue's zero of the temperature effects.
_REFERENCE_C = 25.0
#: Share of the mean count that a part of the sphere without a posture has.
_EMPTY = 0.05


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


@dataclass(frozen=True)
class Row:
    """corrected = scale (raw + offset + slope (T - middle)), in the sensor's own axes.

    scale, offset (g), slope (g/°C) : (3,); middle : °C
    over the sphere and the calibrated ranges, by leaving out the rest, against the calibration:
    lost, worst : mg, mean (by postures recorded) and largest error of |a|; vector : mg, mean error
    of the vector, and angle : deg, the largest of its direction, both after the turn (deg) from the
    tool's axes to the sensor's
    """

    scale: Array
    offset: Array
    slope: Array
    middle: float
    lost: float
    worst: float
    vector: float
    angle: float
    turn: float


def nearest_row(calibration: Calibration, *, slope: bool = True) -> Row:
    """The coefficients that make the norm right, by least squares: as postures were recorded where
    the calibration tells them, else in all by the same weight.

    slope : whether the form has one over temperature; without, offsets are those of the middle.
    """
    seen = sphere_of(calibration)
    raw, force = seen.reading / STANDARD_GRAVITY, seen.force / STANDARD_GRAVITY
    low, high = calibration.valid.get("temperature", (_REFERENCE_C, _REFERENCE_C))
    middle = 0.5 * (low + high)
    # What multiplies the offsets and slopes of all axes, (n, 1 or 2).
    by = np.ones((len(raw), 1))
    if slope and "temperature" in seen.context:
        by = np.column_stack([by, seen.context["temperature"] - middle])
    start = np.concatenate([np.diag(calibration.matrices().M), np.zeros(3 * by.shape[1])])
    weight = _posture_weights(calibration, raw)

    def corrected(p: Array) -> Array:
        return np.asarray(p[:3] * (raw + by @ p[3:].reshape(-1, 3)))

    def linearised(p: Array) -> tuple[Array, Array]:
        """What a norm lacks, and the norm's slopes."""
        a = corrected(p)
        norm = np.linalg.norm(a, axis=1)
        along = a / norm[:, None]
        slopes = [along * a / p[:3], *(along * p[:3] * one[:, None] for one in by.T)]
        root = np.sqrt(weight)
        return root * (1.0 - norm), root[:, None] * np.concatenate(slopes, axis=1)

    # Not scipy's, whose imports take as long as a tenth of a day's calibration without a search.
    found = minimise(linearised, np.add, start).state
    off = 1e3 * np.abs(np.linalg.norm(corrected(found), axis=1) - 1.0)
    vector, angle, turn = _off(corrected(found), force)
    return Row(
        scale=found[:3],
        offset=found[3:6],
        slope=found[6:] if by.shape[1] > 1 else np.zeros(3),
        middle=middle,
        lost=float(weight @ off / weight.sum()),
        worst=float(off.max()),
        vector=vector,
        angle=angle,
        turn=turn,
    )


def _posture_weights(calibration: Calibration, raw: Array) -> Array:
    """(n,) weight of readings (n, 3): the postures in each one's part of the sphere. An empty part
    has a twentieth of the usual, so that nothing runs away there."""
    counts = np.asarray(calibration.facts.get("postures", ()), float)
    if counts.size != CELLS or not counts.any():
        return np.ones(len(raw))
    return np.asarray((counts + _EMPTY * counts.mean())[cell_of(raw)])


def _off(corrected: Array, force: Array) -> tuple[float, float, float]:
    """Mean error of the vector (mg) and largest of its direction (deg) after the turn that brings
    the forces nearest, and that turn's angle (deg)."""
    # Kabsch (1976).
    u, _, v = np.linalg.svd(corrected.T @ force)
    turned = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    due = force @ turned.T
    across = np.linalg.norm(np.cross(corrected, due), axis=1)
    angle = np.arctan2(across, np.einsum("ni,ni->n", corrected, due))
    vector = 1e3 * np.linalg.norm(corrected - due, axis=1).mean()
    axis = turned[[2, 0, 1], [1, 2, 0]] - turned[[1, 2, 0], [2, 0, 1]]
    turn = np.arctan2(np.linalg.norm(axis), np.trace(turned) - 1.0)
    return float(vector), float(angle.max() / DEG), float(turn / DEG)


def demand_one(calibration: Calibration, what: str) -> None:
    """Raise UsageError for an array, of which the form holds one."""
    if calibration.triads:
        raise UsageError(
            f"{what} holds one accelerometer, this calibration is of "
            f"{len(calibration.triads)} IMUs",
            remedy="use c-header",
        )


def heading(calibration: Calibration, filename: str, lost: Sequence[str], *said: str) -> list[str]:
    """The comment that a file opens with. lost : what is not in it; said : lines about the form"""
    first = f"Accelerometer by imucal, from {filename}, status {calibration.status}."
    lines = (first, *said, *(f"Not in it: {text}." for text in lost))
    return [f"# {line}" for line in lines]


def lost_per_axis(calibration: Calibration, row: Row, aside: str = "") -> tuple[str, ...]:
    """What a row does not carry, in words; aside : of the form, after the effects' names."""
    carried = ("mounting", "bias", "scale", *(["temperature_bias"] if np.any(row.slope) else []))
    names, words = calibration.model()[0].names, list[str]()
    if beyond := ", ".join(in_words(n) for n in names if n not in carried):
        words.append(
            f"{beyond}{aside}: {row.lost:.2f} mg of |a| on average over the sphere and the "
            f"calibrated ranges, {row.worst:.2f} mg at most; direction {row.angle:.3f} deg at most"
        )
    if "mounting" in names:
        words.append(f"mounting, the turn of {row.turn:.2f} deg from the tool to the sensor")
    return (*words, *lost_parts(calibration))
