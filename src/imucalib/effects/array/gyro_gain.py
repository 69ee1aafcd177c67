"""Gyro gains: scale, misalignment, and what all gyros share of them."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth, own_axis, three

_CROSS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
_SHEET = "MPU-6050 data sheet 6.1: scale ±3 %, cross-axis ±2 %"
#: Traceless matrices: what all gyros can share and accelerometers can see.
_FRAME = np.array(
    [np.outer(np.eye(3)[i], np.eye(3)[j]) for i, j in _CROSS]
    + [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])]
)


def _scale(truth: Truth, context: Context) -> Array:
    return 0.01 * own_axis(truth.turning.rate)


def _scale_drift(truth: Truth, context: Context) -> Array:
    return _scale(truth, context) * (context["order"] - 0.5)[:, None, None, None]


def _misalignment(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 6))
    for column, (i, j) in enumerate(_CROSS):
        out[..., i, column] = 0.01 * truth.turning.rate[..., j]
    return out


def _frame(truth: Truth, context: Context) -> Array:
    rate = context.in_common(truth.turning.rate)
    return context.in_own(0.01 * np.einsum("cij,tkj->tkic", _FRAME, rate))


def _common(truth: Truth, context: Context) -> Array:
    return 0.01 * truth.turning.rate[..., None]


EFFECTS = (
    Response(
        "gyro_scale",
        "Each gyro axis multiplies the rate by its own factor.",
        "y_i = (1 + s_i) ω_i",
        _SHEET,
        "Turn about all axes; the mean over all gyros trades off against the array's size.",
        ("rate",),
        three("gyro_scale", "%", 3.0, 20.0),
        _scale,
        channel="angular_rate",
        scan=True,
    ),
    Response(
        "gyro_scale_drift",
        "The gyro scales move steadily during the motion.",
        "y_i = (1 + d_i (order - 1/2)) ω_i, order from 0 to 1",
        "0.02 %/degC of consumer gyros, some degC of warming up",
        "Let the board warm up first; twist at the beginning and at the end.",
        ("rate", "order"),
        three("gyro_scale_drift", "%", 0.2, 20.0),
        _scale_drift,
        channel="angular_rate",
        remedy="its gyro's scale moves: let it warm up, check its supply, or leave it out",
    ),
    Response(
        "gyro_misalignment",
        "Each gyro axis also reads the rates about the others.",
        "y_i = ω_i + Σ_j m_ij ω_j,  j ≠ i",
        _SHEET,
        "Turn about all axes.",
        ("rate",),
        tuple(
            Parameter(f"gyro_misalignment_{'xyz'[i]}{'xyz'[j]}", "%", 2.0, 20.0) for i, j in _CROSS
        ),
        _misalignment,
        channel="angular_rate",
        scan=True,
    ),
    Response(
        "gyro_frame",
        "All gyros together are turned and skewed against the accelerometers.",
        "y = (I + F) ω, F the same for all, trace F = 0",
        "die and package mounting, 1 deg",
        "Turn fast about all axes: the accelerometers show the rate by its square.",
        ("rate",),
        tuple(
            Parameter(f"gyro_frame_{n}", "%", 1.0, 20.0)
            for n in ("xy", "xz", "yx", "yz", "zx", "zy", "x_less_y", "y_less_z")
        ),
        _frame,
        channel="angular_rate",
        shared=True,
    ),
    Response(
        "common_gyro_scale",
        "All gyros multiply the rate by one factor.",
        "y = (1 + s) ω, the same for all",
        _SHEET,
        "Measure the array's size, or one gyro's scale on a turntable.",
        ("rate",),
        (Parameter("common_gyro_scale", "%", 1.0, 20.0),),
        _common,
        channel="angular_rate",
        shared=True,
    ),
)
