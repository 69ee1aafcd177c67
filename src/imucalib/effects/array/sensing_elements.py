"""Where in its package each accelerometer axis senses."""

import numpy as np

from imucalib.core.array_motion import Array, ArrayEffect, ArrayMotion
from imucalib.core.parameter import Parameter

_MM = 1e-3


def _columns(motion: ArrayMotion) -> Array:
    """Axis i senses at d_i (package axes) off the triad's position: a_i += (W R d_i)_i."""
    w, spin = motion.rate, motion.spin
    square = w[:, :, None] * w[:, None] - np.sum(w * w, axis=1)[:, None, None] * np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        square[:, i, j] -= spin[:, k]
        square[:, j, i] += spin[:, k]
    turn = motion.rotations
    inside = np.matmul(turn.transpose(0, 2, 1), np.matmul(square[:, None], turn)) * _MM
    out = np.zeros((*motion.shape, 3, 9))
    for i in range(3):
        out[:, :, i, 3 * i : 3 * i + 3] = inside[:, :, i]
    return motion.turned(out)


EFFECTS = (
    ArrayEffect(
        "sensing_elements",
        "accelerometer",
        "The three axes of an accelerometer sense at different points, alike in every package.",
        "a_i taken at r_k + R_k d_i",
        "0.3-1 mm in a 4 x 4 x 1 mm package; the size effect of Kalibr",
        "Packages in two or more attitudes on the board; their common part is the position.",
        tuple(Parameter(f"element_{i}_at_{j}", "mm", 0.5, 5.0) for i in "xyz" for j in "xyz"),
        _columns,
        shared=True,
    ),
)
