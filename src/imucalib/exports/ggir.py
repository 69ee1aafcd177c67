"""GGIR's back-up table of coefficients."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from io import StringIO

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError
from imucalib.exports import Export
from imucalib.exports.linear import lost_parts, sphere_of
from imucalib.units import STANDARD_GRAVITY

#: The catalogue's zero of the temperature effects.
_REFERENCE_C = 25.0


def ggir_csv(calibration: Calibration, filename: str) -> tuple[str, tuple[str, ...]]:
    """One row of GGIR's backup.cal.coef: corrected = scale * (raw + offset + tempoffset ΔT), in g.

    GGIR has no terms between the axes, so the row holds the numbers that come nearest over an even
    sphere and the temperatures that were seen; their own mean error goes to cal.error.end with the
    calibration's. ΔT counts from the middle of those temperatures, where the offsets hold. Raises
    UsageError for an array.
    """
    if calibration.triads:
        raise UsageError(
            f"a row of GGIR holds one accelerometer, this calibration is of "
            f"{len(calibration.triads)} IMUs",
            remedy="use c-header",
        )
    row = nearest_row(calibration)
    start, end = _errors(calibration)
    numbers = {
        "cal.error.start": start * 1e-3,
        "cal.error.end": np.hypot(end, row.lost) * 1e-3,
        **{f"scale.{a}": row.scale[k] for k, a in enumerate("xyz")},
        **{f"offset.{a}": row.offset[k] for k, a in enumerate("xyz")},
        **{f"temperature.offset.{a}": row.slope[k] for k, a in enumerate("xyz")},
        "meantempcal": row.middle,
    }
    out = StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["filename", *numbers])
    writer.writerow([filename, *(f"{v:.9g}" for v in numbers.values())])
    lost = (
        f"what GGIR has no coefficient for: {row.lost:.2f} mg on average over the sphere, which "
        "cal.error.end includes",
        *lost_parts(calibration),
    )
    return out.getvalue(), lost


def _errors(calibration: Calibration) -> tuple[float, float]:
    """The principal error raw and held out, mg; NaN where the file does not tell."""
    for error in calibration.facts.get("errors", ()):
        if error["unit"] == "mg":
            raw, final = (
                np.nan if v is None else float(v)
                for v in (error["raw"], error["held_out"]["final"])
            )
            return raw, final
    return np.nan, np.nan


@dataclass(frozen=True)
class Row:
    """scale, offset (g), slope (g/°C) : (3,); middle : °C; lost : mg, the mean error of |a| that
    leaving out the rest makes."""

    scale: Array
    offset: Array
    slope: Array
    middle: float
    lost: float


def nearest_row(calibration: Calibration) -> Row:
    """GGIR's coefficients that make the norm right over the sphere, by least squares."""
    from scipy.optimize import least_squares

    seen = sphere_of(calibration)
    raw = seen.reading / STANDARD_GRAVITY
    low, high = calibration.valid.get("temperature", (_REFERENCE_C, _REFERENCE_C))
    middle = 0.5 * (low + high)
    warm = seen.context["temperature"] - middle if "temperature" in seen.context else None
    start = np.concatenate([np.diag(calibration.matrices().M), np.zeros(3 if warm is None else 6)])

    def norm_error(p: Array) -> Array:
        offset = p[3:6] if warm is None else p[3:6] + warm[:, None] * p[6:]
        return np.asarray(np.linalg.norm(p[:3] * (raw + offset), axis=1) - 1.0)

    found = least_squares(norm_error, start, x_scale="jac", xtol=1e-12, ftol=1e-12).x
    slope = np.zeros(3) if warm is None else found[6:]
    lost = float(np.mean(np.abs(norm_error(found)))) * 1e3
    return Row(found[:3], found[3:6], slope, middle, lost)


EXPORT = Export("ggir-csv", "ggir_calibration.csv", ggir_csv)
