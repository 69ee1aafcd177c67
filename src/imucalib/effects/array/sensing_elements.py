"""Where in its package each accelerometer axis senses."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth

_MM = 1e-3


def across(truth: Truth) -> Array:
    """(n, K, 3, 3) s^-2, W d = ω × (ω × d) + dω/dt × d in each package's axes."""
    w, spin = truth.turning.rate, truth.turning.spin
    inside = w[..., :, None] * w[..., None, :] - np.sum(w * w, axis=-1)[..., None, None] * np.eye(3)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        inside[..., i, j] -= spin[..., k]
        inside[..., j, i] += spin[..., k]
    return np.asarray(inside)


def _columns(truth: Truth, context: Context) -> Array:
    """Axis i senses at d_i (package axes) off the triad's position: a_i += (W d_i)_i."""
    inside = across(truth)
    out = np.zeros((*truth.shape, 9))
    for i in range(3):
        out[..., i, 3 * i : 3 * i + 3] = _MM * inside[..., i, :]
    return out


EFFECTS = (
    Response(
        "sensing_elements",
        "The three axes of an accelerometer sense at different points, alike in every package.",
        "y_i = a_i + (ω × (ω × d_i) + dω/dt × d_i)_i,  d_i the same in all packages",
        "0.3-1 mm in a 4 x 4 x 1 mm package; the size effect of Kalibr",
        "Packages in two or more attitudes on the board; their common part is the position.",
        ("rate", "spin"),
        tuple(Parameter(f"element_{i}_at_{j}", "mm", 0.5, 5.0) for i in "xyz" for j in "xyz"),
        _columns,
        shared=True,
    ),
)
