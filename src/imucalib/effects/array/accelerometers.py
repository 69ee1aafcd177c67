"""Accelerometer errors: the shared catalogue's, in each package's axes, and what all share."""

from collections.abc import Callable

import numpy as np

from imucalib.core.array_motion import Array, ArrayEffect, ArrayMotion
from imucalib.core.context import Context
from imucalib.core.effect import Response
from imucalib.core.parameter import Parameter
from imucalib.effects import catalogue

_CROSS = tuple((i, j) for i in range(3) for j in range(3) if i != j)
#: Effect of the shared catalogue: its size after calibration at rest, in its own unit, and
#: whether one IMU alone is tried.
_SHARED = {
    "scale": (2e-3, True),
    "bias": (2.0, True),
    "quadratic": (0.3, False),
    "cubic": (0.02, False),
    "asymmetry": (2.0, False),
    "cross_axis": (0.3, False),
    "bias_drift": (2.0, False),
    "warm_up": (2.0, False),
}


def _columns(effect: Response) -> Callable[[ArrayMotion], Array]:
    def basis(motion: ArrayMotion) -> Array:
        context = Context(len(motion.t), {"order": motion.order, "time": motion.t}, motion.imus)
        return motion.turned(effect.basis(motion.seen(motion.force), context))

    return basis


def _adapted(name: str, typical: float, scan: bool) -> ArrayEffect:
    effect = catalogue()[name]
    assert isinstance(effect, Response)
    each = tuple(Parameter(p.name, p.unit, typical, p.plausible) for p in effect.each)
    return ArrayEffect(
        f"accelerometer_{name}",
        "accelerometer",
        effect.sentence,
        effect.equation,
        effect.source,
        effect.identify,
        each,
        _columns(effect),
        scan=scan,
    )


def _misalignment(motion: ArrayMotion) -> Array:
    force = motion.seen(motion.force)
    out = np.zeros((*force.shape, 6))
    for column, (i, j) in enumerate(_CROSS):
        out[:, :, i, column] = 0.01 * force[:, :, j]
    return motion.turned(out)


def _common_scale(motion: ArrayMotion) -> Array:
    return np.asarray(0.01 * motion.force[..., None])


def _common_bias(motion: ArrayMotion) -> Array:
    return np.broadcast_to(np.eye(3) * 9.80665e-3, (*motion.shape, 3, 3))


EFFECTS = (
    *(_adapted(name, *size) for name, size in _SHARED.items()),
    ArrayEffect(
        "accelerometer_misalignment",
        "accelerometer",
        "Each axis also reads the force along the others.",
        "y_i = a_i + Σ_j m_ij a_j,  j ≠ i",
        "5 mrad after calibration at rest",
        "More rests, in more attitudes.",
        tuple(Parameter(f"misalignment_{'xyz'[i]}{'xyz'[j]}", "%", 0.3, 10.0) for i, j in _CROSS),
        _misalignment,
        scan=True,
    ),
    ArrayEffect(
        "common_accelerometer_scale",
        "accelerometer",
        "All accelerometers multiply the force by one factor, as a wrong gravity makes them.",
        "y = (1 + s) a, the same for all",
        "local gravity, 0.3 %",
        "State the local gravity.",
        (Parameter("common_accelerometer_scale", "%", 0.3, 10.0),),
        _common_scale,
        shared=True,
    ),
    ArrayEffect(
        "common_accelerometer_bias",
        "accelerometer",
        "All accelerometers read one constant more.",
        "y = a + b, the same for all",
        "absorbed by the specific force of every sample",
        "Rests before and after the motion.",
        tuple(Parameter(f"common_bias_{a}", "mg", 2.0, 500.0) for a in "xyz"),
        _common_bias,
        shared=True,
    ),
)
