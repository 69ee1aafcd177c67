"""Scale factor error of each axis."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth


def _basis(truth: Truth, context: Context) -> Array:
    return np.asarray(np.eye(3) * truth.force[..., None])


def _basis_dx(truth: Truth, context: Context) -> Array:
    out = np.zeros((*truth.shape, 3, 3))
    for axis in range(3):
        out[..., axis, axis, axis] = 1.0
    return out


EFFECTS = (
    Response(
        "scale",
        "Each axis multiplies the specific force by its own factor.",
        "y_i = (1 + s_i) x_i",
        "paper 004 eq. (3), p. 3; IEEE Std 1293 term K1",
        "Show each axis both signs of gravity.",
        each=tuple(Parameter(f"scale_{a}", "1", 0.03, 0.5) for a in "xyz"),
        basis=_basis,
        basis_dx=_basis_dx,
    ),
)
