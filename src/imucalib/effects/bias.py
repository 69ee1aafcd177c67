"""Zero offset of each axis."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.units import MG


def _basis(truth: Truth, context: Context) -> Array:
    return np.broadcast_to(np.eye(3) * MG, (*truth.shape, 3))


EFFECTS = (
    Response(
        "bias",
        "Each axis reads a constant beside the specific force.",
        "y_i = x_i + b_i",
        "paper 004 eq. (3), p. 3; IEEE Std 1293 term K0",
        "Show each axis both signs of gravity.",
        each=tuple(Parameter(f"bias_{a}", "mg", 50.0, 1000.0) for a in "xyz"),
        basis=_basis,
    ),
)
