"""A scale with a period of one day, beside the bias that has it (`effects/cycle`)."""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.context import Context
from imucalib.core.effect import Response
from imucalib.core.parameter import Parameter
from imucalib.core.truth import Truth

_PER_MILLE = 1e-3  # mg/g


def _waves(context: Context) -> Array:
    """(n, 1, 3, 6) cosine and sine of each axis."""
    angle = context["time_of_day"][:, None, None, None]
    own = _PER_MILLE * np.eye(3)
    return np.concatenate([own * np.cos(angle), own * np.sin(angle)], axis=-1)


def _basis(truth: Truth, context: Context) -> Array:
    return np.asarray(truth.force[..., None] * _waves(context))


def _basis_dx(truth: Truth, context: Context) -> Array:
    each = _waves(context)[..., None] * np.eye(3)[:, None]
    return np.broadcast_to(each, (*truth.shape, 6, 3))


EFFECTS = (
    Response(
        "scale_by_time_of_day",
        "The scale factor swings once a day.",
        "y_i = x_i (1 + c_i cos(φ) + s_i sin(φ)),  φ = 2π time of day",
        "stands in for the temperature where none was recorded",
        "Record several days, and the temperature.",
        ("time_of_day",),
        each=tuple(
            Parameter(f"daily_scale_{w}_{a}", "mg/g", 0.3, 20.0)
            for w in ("cos", "sin")
            for a in "xyz"
        ),
        basis=_basis,
        basis_dx=_basis_dx,
    ),
)
