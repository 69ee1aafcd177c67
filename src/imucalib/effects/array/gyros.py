"""Gyros: gains, offsets, and what bends their response."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Basis, Context, Parameter, Response, Truth
from imucalib.effects.array.parts import (
    FORCE,
    OTHERS,
    RATE,
    all_axes,
    any_axis,
    each_axis,
    one,
    other_axes,
    times,
)
from imucalib.units import DEG, STANDARD_GRAVITY

_SHEET = "MPU-6050 data sheet 6.1: "
_GAINS = _SHEET + "scale ±3 %, cross-axis ±2 %"
_BENT = _SHEET + "non-linearity 0.2 % of full scale"
_FULL = 2000.0 * DEG
_REFERENCE = 25.0  # °C
#: Traceless matrices: what all gyros can share and accelerometers can see.
_FRAME = np.array(
    [np.outer(np.eye(3)[i], np.eye(3)[j]) for i, j in OTHERS]
    + [np.diag([1.0, -1.0, 0.0]), np.diag([0.0, 1.0, -1.0])]
)

_SCALE, _BIAS = each_axis(RATE, 0.01), each_axis(one, DEG)
_CROSS = [f"_{'xyz'[i]}{'xyz'[j]}" for i, j in OTHERS]


def _late(truth: Truth, context: Context) -> Array:
    return np.asarray(context["order"] - 0.5)


def _warmer(truth: Truth, context: Context) -> Array:
    return np.asarray(context["temperature"] - _REFERENCE)


def _power(p: int) -> Callable[[Truth], Array]:
    return lambda truth: np.asarray((truth.turning.rate / _FULL) ** p)


def _size(truth: Truth) -> Array:
    return np.abs(truth.turning.rate)


def _frame(truth: Truth, context: Context) -> Array:
    common = context.in_common(truth.turning.rate)
    return context.in_own(0.01 * np.einsum("cij,tkj->tkic", _FRAME, common))


def _saturation(truth: Truth, context: Context) -> Array:
    """Of a tanh of 1500 deg/s at 700 deg/s rms a cube leaves 24 deg/s, two powers 6. With a third
    (2) one gyro's bend passed for that of all more often: one board of seven was 0.35 % too large.
    """
    powers = (each_axis(_power(p), DEG)(truth, context) for p in (3, 5))
    return np.concatenate(list(powers), axis=-1)


def _gyro(
    name: str,
    sentence: str,
    equation: str,
    source: str,
    identify: str,
    size: tuple[str, float, float],
    basis: Basis,
    *,
    numbers: Sequence[str] = ("_x", "_y", "_z"),
    needs: tuple[str, ...] = (),
    **more: Any,
) -> Response:
    """size : unit, typical and plausible size of a parameter; numbers : what their names end in."""
    each = tuple(Parameter(name + end, *size) for end in numbers)
    words = (name, sentence, equation, source, identify)
    return Response(*words, ("rate", *needs), each, basis, channel="angular_rate", **more)


EFFECTS = (
    _gyro(
        "gyro_asymmetry",
        "The gyros' scale differs between the two directions of turning.",
        "y_i = ω_i + k_i |ω_i|",
        "IEEE Std 528, asymmetry error",
        "Turn both ways about each axis, slowly and fast.",
        ("%", 0.2, 5.0),
        each_axis(_size, 0.01),
    ),
    _gyro(
        "gyro_scale",
        "Each gyro axis multiplies the rate by its own factor.",
        "y_i = (1 + s_i) ω_i",
        _GAINS,
        "Turn about all axes; the mean over all gyros trades off against the array's size.",
        ("%", 3.0, 20.0),
        _SCALE,
    ),
    _gyro(
        "gyro_scale_drift",
        "The gyro scales move steadily during the motion.",
        "y_i = (1 + d_i (order - 1/2)) ω_i, order from 0 to 1",
        "0.02 %/degC of consumer gyros, some degC of warming up",
        "Let the board warm up first; twist at the beginning and at the end.",
        ("%", 0.2, 20.0),
        times(_SCALE, _late),
        needs=("order",),
        remedy="its gyro's scale moves: let it warm up, check its supply, or leave it out",
    ),
    _gyro(
        "gyro_misalignment",
        "Each gyro axis also reads the rates about the others.",
        "y_i = ω_i + Σ_j m_ij ω_j,  j ≠ i",
        _GAINS,
        "Turn about all axes.",
        ("%", 2.0, 20.0),
        other_axes(RATE, 0.01),
        numbers=_CROSS,
    ),
    _gyro(
        "gyro_frame",
        "All gyros together are turned and skewed against the accelerometers.",
        "y = (I + F) ω, F the same for all, trace F = 0",
        "die and package mounting, 1 deg",
        "Turn fast about all axes: the accelerometers show the rate by its square.",
        ("%", 1.0, 20.0),
        _frame,
        numbers=[*_CROSS, "_x_less_y", "_y_less_z"],
        shared=True,
    ),
    _gyro(
        "common_gyro_scale",
        "All gyros multiply the rate by one factor.",
        "y = (1 + s) ω, the same for all",
        _GAINS,
        "Measure the array's size, or one gyro's scale on a turntable.",
        ("%", 1.0, 20.0),
        all_axes(RATE, 0.01),
        numbers=[""],
        shared=True,
    ),
    _gyro(
        "gyro_bias",
        "Each gyro axis reads another constant in motion than at rest.",
        "y_i = ω_i + b_i",
        "0.1 deg/s after still calibration",
        "Rests right before and after the motion.",
        ("deg/s", 0.1, 20.0),
        _BIAS,
    ),
    _gyro(
        "gyro_drift",
        "The gyro biases move steadily during the motion.",
        "y_i = ω_i + d_i (order - 1/2), order from 0 to 1",
        "0.1 deg/s while a board warms up",
        "Let the board warm up first.",
        ("deg/s", 0.1, 20.0),
        times(_BIAS, _late),
        needs=("order",),
    ),
    _gyro(
        "gyro_g_sensitivity",
        "The gyros also read the specific force.",
        "y_i = ω_i + Σ_j G_ij a_j",
        _SHEET + "0.1 deg/s/g",
        "Shake while turning, so that force and rate do not go together.",
        ("deg/s/g", 0.1, 5.0),
        any_axis(FORCE, DEG / STANDARD_GRAVITY),
        numbers=[f"_{i}{j}" for i in "xyz" for j in "xyz"],
    ),
    _gyro(
        "gyro_quadratic",
        "The gyros' response has a quadratic term.",
        "y_i = ω_i + q_i (ω_i / 2000 deg/s)²",
        _BENT,
        "Turn both ways about each axis, slowly and fast.",
        ("deg/s", 4.0, 200.0),
        each_axis(_power(2), DEG),
    ),
    _gyro(
        "gyro_cubic",
        "The gyros' response has a cubic term.",
        "y_i = ω_i + k_i (ω_i / 2000 deg/s)³",
        _BENT,
        "Turn slowly and fast about each axis.",
        ("deg/s", 4.0, 600.0),
        each_axis(_power(3), DEG),
    ),
    _gyro(
        "gyro_temperature_bias",
        "The gyros' biases follow the temperature.",
        "y_i = ω_i + c_i (T - 25 °C)",
        _SHEET + "20 deg/s from -40 to 85 °C",
        "Rest at two temperatures or more, with the temperature recorded.",
        ("deg/s/degC", 0.03, 1.0),
        times(_BIAS, _warmer),
        needs=("temperature",),
    ),
    _gyro(
        "gyro_temperature_scale",
        "The gyros' scale factors follow the temperature.",
        "y_i = (1 + c_i (T - 25 °C)) ω_i",
        _SHEET + "2 % from -40 to 85 °C",
        "Turn by hand at two temperatures or more, with the temperature recorded.",
        ("%/degC", 0.02, 0.5),
        times(_SCALE, _warmer),
        needs=("temperature",),
    ),
    _gyro(
        "gyro_saturation",
        "The gyros read less of a fast rate, more and more so towards the end of their range.",
        "y_i = ω_i + k_i (ω_i / 2000 deg/s)³ + l_i (ω_i / 2000 deg/s)⁵",
        "2500 deg/s · tanh(ω / 2500 deg/s): -427 and 109 deg/s at 2000 deg/s",
        "Turn slowly and fast about each axis; leave some of the range unused.",
        ("deg/s", 40.0, 2000.0),
        _saturation,
        numbers=[f"_{power}_{axis}" for power in ("third", "fifth") for axis in "xyz"],
    ),
)
