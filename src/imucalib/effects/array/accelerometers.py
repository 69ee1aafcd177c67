"""Accelerometer errors that only motion tells from the rests' own, and what all share."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.units import MG

_CROSS = tuple((i, j) for i in range(3) for j in range(3) if i != j)


def _misalignment(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 6))
    for column, (i, j) in enumerate(_CROSS):
        out[..., i, column] = 0.01 * truth.force[..., j]
    return out


def _misalignment_dx(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 6, 3))
    for column, (i, j) in enumerate(_CROSS):
        out[..., i, column, j] = 0.01
    return out


def _common_scale(truth: Truth, context: Context) -> Array:
    return np.asarray(0.01 * truth.force[..., None])


def _common_scale_dx(truth: Truth, context: Context) -> Array:
    return np.broadcast_to(0.01 * np.eye(3)[:, None], (*truth.shape, 1, 3))


def _common_bias(truth: Truth, context: Context) -> Array:
    one = np.broadcast_to(MG * np.eye(3), (truth.shape[0], 1, 3, 3))
    return context.in_own(one)


EFFECTS = (
    Response(
        "accelerometer_misalignment",
        "Each axis also reads the force along the others.",
        "y_i = a_i + Σ_j m_ij a_j,  j ≠ i",
        "5 mrad after calibration at rest",
        "More rests, in more attitudes.",
        ("rate",),
        tuple(Parameter(f"misalignment_{'xyz'[i]}{'xyz'[j]}", "%", 0.3, 10.0) for i, j in _CROSS),
        _misalignment,
        _misalignment_dx,
        scan=True,
    ),
    Response(
        "common_accelerometer_scale",
        "All accelerometers multiply the force by one factor, as a wrong gravity makes them.",
        "y = (1 + s) a, the same for all",
        "local gravity, 0.3 %",
        "State the local gravity.",
        ("rate",),
        (Parameter("common_accelerometer_scale", "%", 0.3, 10.0),),
        _common_scale,
        _common_scale_dx,
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
)
