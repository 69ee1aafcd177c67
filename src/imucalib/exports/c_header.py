"""A C header for the firmware."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError
from imucalib.exports import Export
from imucalib.units import STANDARD_GRAVITY

Array = NDArray[np.float64]


def c_header(calibration: Calibration, filename: str) -> str:
    """M and b for raw readings in g, as float, Q31 and Q15.

    Fixed point holds M - 1 and b, which are below 1, so that no bit is spent on the integer part:
    corrected = raw + (dM raw + b). Raises UsageError when an entry is 1 or more.
    """
    linear = calibration.matrices()
    change, offset = linear.M - np.eye(3), linear.b / STANDARD_GRAVITY
    if max(np.abs(change).max(), np.abs(offset).max()) >= 1.0:
        raise UsageError("the coefficients do not fit fixed point", remedy="check the unit")
    lines = [
        "/* Accelerometer calibration by imucal: corrected = M * raw + b, in g.",
        f" * From {filename}, status {calibration.status}.",
        " * Fixed point: corrected = raw + dM * raw + b, dM = M - 1. */",
        "#ifndef IMUCAL_CALIBRATION_H",
        "#define IMUCAL_CALIBRATION_H",
        "#include <stdint.h>",
        "",
        _array("float", "imucal_M[3][3]", linear.M, lambda v: f"{v:.9e}f"),
        _array("float", "imucal_b[3]", offset, lambda v: f"{v:.9e}f"),
    ]
    for bits, kind in ((31, "int32_t"), (15, "int16_t")):

        def fixed(value: float, bits: int = bits) -> str:
            return str(round(value * (1 << bits)))

        lines.append(_array(kind, f"imucal_dM_q{bits}[3][3]", change, fixed))
        lines.append(_array(kind, f"imucal_b_q{bits}[3]", offset, fixed))
    return "\n".join([*lines, "", "#endif", ""])


def _array(kind: str, name: str, values: Array, text: Callable[[float], str]) -> str:
    rows = np.atleast_2d(values)
    inner = [", ".join(text(float(v)) for v in row) for row in rows]
    body = inner[0] if values.ndim == 1 else ", ".join(f"{{{row}}}" for row in inner)
    return f"static const {kind} {name} = {{{body}}};"


EXPORT = Export("c-header", "imucal_calibration.h", c_header)
