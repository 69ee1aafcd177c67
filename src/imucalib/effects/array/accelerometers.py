"""Accelerometers: what only motion tells from the rests' errors, and where their axes are."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.effects.array.parts import (
    FORCE,
    OTHERS,
    all_axes,
    by_force,
    displace,
    elements,
    other_axes,
    times,
)
from imucalib.units import DEG, MG, STANDARD_GRAVITY

_FAST = 1000.0 * DEG
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_MISALIGNMENT, _SCALE = other_axes(FORCE, 0.01), all_axes(FORCE, 0.01)


def _common_bias(truth: Truth, context: Context) -> Array:
    return context.in_own(np.broadcast_to(MG * np.eye(3), (len(truth.force), 1, 3, 3)))


def _sensing_elements(truth: Truth, context: Context) -> Array:
    """Axis i senses at d_i (package axes) off the triad's position: a_i += (W d_i)_i."""
    return elements(displace(truth, context))


def _flex(truth: Truth, context: Context) -> Array:
    """A spring is as stiff both ways: C is symmetric."""
    arm = displace(truth, context) / STANDARD_GRAVITY
    out = np.zeros((*truth.shape, len(_PAIRS)))
    for column, (i, j) in enumerate(_PAIRS):
        out[..., column] = arm[..., i] * truth.force[..., j, None]
        if i != j:
            out[..., column] += arm[..., j] * truth.force[..., i, None]
    return out


def _fast(truth: Truth, context: Context) -> Array:
    return np.asarray(np.sum(truth.turning.rate**2, axis=-1) / _FAST**2)


EFFECTS = (
    Response(
        "accelerometer_misalignment",
        "Each axis also reads the force along the others.",
        "y_i = a_i + Σ_j m_ij a_j,  j ≠ i",
        "5 mrad after calibration at rest",
        "More rests, in more attitudes.",
        ("rate",),
        tuple(Parameter(f"misalignment_{'xyz'[i]}{'xyz'[j]}", "%", 0.3, 10.0) for i, j in OTHERS),
        _MISALIGNMENT,
        by_force(_MISALIGNMENT),
    ),
    Response(
        "common_accelerometer_scale",
        "All accelerometers multiply the force by one factor, as a wrong gravity makes them.",
        "y = (1 + s) a, the same for all",
        "local gravity, 0.3 %",
        "State the local gravity.",
        ("rate",),
        (Parameter("common_accelerometer_scale", "%", 0.3, 10.0),),
        _SCALE,
        by_force(_SCALE),
        shared=True,
    ),
    Response(
        "common_accelerometer_bias",
        "All accelerometers read one constant more.",
        "y = a + b, the same for all",
        "absorbed by the specific force of every sample",
        "Rests before and after the motion.",
        ("rate",),
        tuple(Parameter(f"common_bias_{a}", "mg", 2.0, 500.0) for a in "xyz"),
        _common_bias,
        shared=True,
    ),
    Response(
        "flexing",
        "Each IMU's place gives way to the force, as on a spring.",
        "y = a + ω × (ω × d) + dω/dt × d,  d = C a, C symmetric",
        "a loose screw, foam, a thin board: 0.05 mm/g",
        "Twist fast while shaking; fasten the IMU and compare.",
        ("rate", "spin"),
        tuple(Parameter(f"flexing_{'xyz'[i]}{'xyz'[j]}", "mm/g", 0.05, 10.0) for i, j in _PAIRS),
        _flex,
        by_force(_flex),
        remedy="it gives way to the force: fasten it, or stiffen the board there",
    ),
    Response(
        "moved_by_rate",
        "Each IMU's place moves with the square of the rate, as what is loose flies outwards.",
        "y = a + ω × (ω × d) + dω/dt × d,  d = c (|ω| / 1000 deg/s)²",
        "a part that sits loose: 0.05 mm at 1000 deg/s",
        "Twist slowly and fast; fasten the IMU and compare.",
        ("rate", "spin"),
        tuple(Parameter(f"moved_by_rate_{a}", "mm", 0.05, 10.0) for a in "xyz"),
        times(displace, _fast),
        remedy="it moves outwards with the rate: fasten it",
    ),
    Response(
        "sensing_elements",
        "The three axes of an accelerometer sense at different points, alike in every package.",
        "y_i = a_i + (ω × (ω × d_i) + dω/dt × d_i)_i,  d_i the same in all packages",
        "0.3-1 mm in a 4 x 4 x 1 mm package; the size effect of Kalibr",
        "Packages in two or more attitudes on the board; their common part is the position.",
        ("rate", "spin"),
        tuple(Parameter(f"element_{i}_at_{j}", "mm", 0.5, 5.0) for i in "xyz" for j in "xyz"),
        _sensing_elements,
        shared=True,
    ),
)
