"""GGIR's back-up table of coefficients."""

from __future__ import annotations

import csv
from io import StringIO

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration
from imucalib.core.sphere import even_directions
from imucalib.exports import Export
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


EXPORT = Export("ggir-csv", "ggir_calibration.csv", ggir_csv)
