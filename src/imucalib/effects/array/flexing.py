"""An IMU that does not stay where it is: its place moves with the force, or with the rate."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.effects.array.sensing_elements import across
from imucalib.units import DEG, STANDARD_GRAVITY

_MM, _FAST = 1e-3, 1000.0 * DEG
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


def _by_force(truth: Truth, context: Context) -> Array:
    """A spring is as stiff both ways: C is symmetric."""
    arm = across(truth) * _MM / STANDARD_GRAVITY
    out = np.zeros((*truth.shape, len(_PAIRS)))
    for column, (i, j) in enumerate(_PAIRS):
        out[..., column] = arm[..., i] * truth.force[..., j, None]
        if i != j:
            out[..., column] += arm[..., j] * truth.force[..., i, None]
    return out


def _by_force_dx(truth: Truth, context: Context) -> Array:
    arm = across(truth) * _MM / STANDARD_GRAVITY
    out = np.zeros((*truth.shape, len(_PAIRS), 3))
    for column, (i, j) in enumerate(_PAIRS):
        out[..., column, j] = arm[..., i]
        if i != j:
            out[..., column, i] = arm[..., j]
    return out


def _by_rate(truth: Truth, context: Context) -> Array:
    square = np.sum(truth.turning.rate**2, axis=-1) / _FAST**2
    return np.asarray(across(truth) * _MM * square[..., None, None])


EFFECTS = (
    Response(
        "flexing",
        "Each IMU's place gives way to the force, as on a spring.",
        "y = a + ω × (ω × d) + dω/dt × d,  d = C a, C symmetric",
        "a loose screw, foam, a thin board: 0.05 mm/g",
        "Twist fast while shaking; fasten the IMU and compare.",
        ("rate", "spin"),
        tuple(Parameter(f"flexing_{'xyz'[i]}{'xyz'[j]}", "mm/g", 0.05, 10.0) for i, j in _PAIRS),
        _by_force,
        _by_force_dx,
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
        _by_rate,
        remedy="it moves outwards with the rate: fasten it",
    ),
)
