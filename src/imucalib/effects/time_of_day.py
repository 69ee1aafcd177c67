"""A bias with a period of one day, where no thermometer explains it."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth
from imucalib.units import MG


def _basis(truth: Truth, context: Context) -> Array:
    angle = context["time_of_day"]
    waves = np.stack([np.cos(angle), np.sin(angle)])[:, :, None, None, None]
    both = np.concatenate([np.eye(3) * waves[0], np.eye(3) * waves[1]], axis=-1)
    return np.broadcast_to(MG * both, (*truth.shape, 6))


EFFECTS = (
    Response(
        "time_of_day",
        "The bias swings once a day.",
        "y_i = x_i + c_i cos(φ) + s_i sin(φ),  φ = 2π time of day",
        "stands in for the temperature where none was recorded",
        "Record several days, and the temperature.",
        ("time_of_day",),
        each=tuple(
            Parameter(f"daily_{w}_{a}", "mg", 0.3, 20.0) for w in ("cos", "sin") for a in "xyz"
        ),
        basis=_basis,
    ),
)
