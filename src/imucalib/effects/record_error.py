"""A gross error of one record: a free number on one component of one observation.

Not part of the catalogue that is scored block by block: `record_errors.py` scans all records.
"""

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context, Parameter, Response, Truth
from imucalib.units import MG

_PREFIX = "record_error_"
#: Size of a gross error, mg: a number misread, or another attitude, up to gravity and more.
GROSS_MG = 300.0


def is_record_error(name: str) -> bool:
    """Whether an effect's name is that of one record's error: no part of any calibration."""
    return name.startswith(_PREFIX)


def record_of(name: str) -> int:
    """The record that an effect of this name sets aside; -1 of any other effect."""
    return int(name[len(_PREFIX) :].partition("_")[0]) if is_record_error(name) else -1


def record_error(record: int, label: str, axes: str = "xyz") -> Response:
    """Free error of some axes of the observation whose covariate "record" equals `record`."""
    columns = ["xyz".index(a) for a in axes]

    def basis(truth: Truth, context: Context) -> Array:
        hit = (context["record"] == record).astype(float)[:, None, None, None] * MG
        return np.broadcast_to(np.eye(3)[:, columns] * hit, (*truth.shape, len(columns)))

    return Response(
        f"{_PREFIX}{record}_{axes}",
        f"The record of {label} is wrong in {', '.join(axes)}.",
        "y = x + e, on this record only",
        "geodetic data snooping (Baarda 1968)",
        "Look at the laboratory's notes, or take the position again.",
        ("record",),
        each=tuple(Parameter(f"record_{record}_{a}", "mg", GROSS_MG, 1e7) for a in axes),
        basis=basis,
    )
