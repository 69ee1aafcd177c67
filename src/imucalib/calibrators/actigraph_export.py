"""Coefficients for others: GGIR's back-up table, and a C header for the firmware."""

from __future__ import annotations

import csv
from collections.abc import Callable
from io import StringIO

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration import Calibration
from imucalib.calibrators.actigraph_errors import even_directions
from imucalib.errors import UsageError
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]

#: The catalogue's zero of the temperature effects.
_REFERENCE_C = 25.0


def ggir_csv(calibration: Calibration, filename: str) -> str:
    """One row of GGIR's backup.cal.coef: corrected = scale * (raw + offset + tempoffset ΔT), in g.

    GGIR has no terms between the axes, so the row holds the six numbers that come nearest over an
    even sphere; their own largest error goes to cal.error.end with the calibration's. ΔT counts
    from the middle of the temperatures that were seen, where the offsets hold.
    """
    scale, offset, lost = nearest_six(calibration)
    span = calibration.valid.get("temperature", (_REFERENCE_C, _REFERENCE_C))
    middle = 0.5 * (span[0] + span[1])
    slope = np.zeros(3)
    for p in calibration.parameters:
        if p.effect == "temperature_bias":
            slope["xyz".index(p.name[-1])] = -p.value * MG / STANDARD_GRAVITY
    offset = offset + slope * (middle - _REFERENCE_C)
    error = dict(calibration.facts.get("error_mg", {}))
    end = np.hypot(float(error.get("final_held_out", 0.0)), lost) * 1e-3
    numbers = {
        "cal.error.start": float(error.get("raw", 0.0)) * 1e-3,
        "cal.error.end": end,
        **{f"scale.{a}": scale[k] for k, a in enumerate("xyz")},
        **{f"offset.{a}": offset[k] for k, a in enumerate("xyz")},
        **{f"temperature.offset.{a}": slope[k] for k, a in enumerate("xyz")},
        "meantempcal": middle,
    }
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["filename", *numbers])
    writer.writerow([filename, *(f"{v:.9g}" for v in numbers.values())])
    return out.getvalue()


def nearest_six(calibration: Calibration) -> tuple[Array, Array, float]:
    """Scale (3,), offset (3,) in g and the mean error (mg) that leaving out the rest makes."""
    from scipy.optimize import least_squares

    linear = calibration.matrices()
    sphere = even_directions(600)
    raw = sphere @ linear.S.T + linear.c / STANDARD_GRAVITY

    def norm_error(p: Array) -> Array:
        return np.asarray(np.linalg.norm(p[:3] * (raw + p[3:]), axis=1) - 1.0)

    found = least_squares(norm_error, np.concatenate([np.diag(linear.M), np.zeros(3)])).x
    return found[:3], found[3:], float(np.mean(np.abs(norm_error(found)))) * 1e3


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


#: Format -> (file name, writer).
EXPORTS: dict[str, tuple[str, Callable[[Calibration, str], str]]] = {
    "ggir-csv": ("ggir_calibration.csv", ggir_csv),
    "c-header": ("imucal_calibration.h", c_header),
}
