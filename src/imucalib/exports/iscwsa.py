"""The accelerometers' terms of a well-position error model, as ISCWSA and OWSG name them: CSV."""

from __future__ import annotations

import csv
from io import StringIO

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.nearest import demand_one, heading, lost_linear, nearest_linear
from imucalib.units import MG

_COLUMNS = "term axis towards value sd unit code weight_function propagation"
#: Code, weighting function and what it weighs, of magnetic (MWD) and of gyro tools.
_CODES = (
    ("ABXY-TI1S", "ABXY-TI1", "bias", "xy"),
    ("ABXY-TI2S", "ABXY-TI2", "bias", "xy"),
    ("ABZ", "ABZ", "bias", "z"),
    ("ASXY-TI1S", "ASXY-TI1", "scale", "xy"),
    ("ASXY-TI2S", "ASXY-TI2", "scale", "xy"),
    ("ASXY-TI3S", "ASXY-TI3", "scale", "xy"),
    ("ASZ", "ASZ", "scale", "z"),
    ("AXYZ-XYB", "AXYZ-XYB", "bias", "xy"),
    ("AXYZ-ZB", "AXYZ-ZB", "bias", "z"),
    ("AXYZ-SF", "AXYZ-SF", "scale", "xyz"),
    ("AXYZ-MIS", "AXYZ-MIS", "misalignment", "xyz"),
)
_UNITS = {"bias": "m/s2", "scale": "-", "misalignment": "rad"}


def iscwsa(calibration: Calibration, filename: str) -> Made:
    """Rows without a code: what each axis reads too much, value and standard deviation, reading =
    force + bias + scale force + misalignment x force of the axis `towards`. Rows with a code: one
    standard deviation of what the corrected tool still has of it, the rms over its axes, as a tool
    code takes it (OWSG tool codes; gyro: SPE 90408). Raises UsageError for an array.
    """
    demand_one(calibration, "an error model")
    linear, known = nearest_linear(calibration), calibration.matrices()
    S, S_sd = np.linalg.inv(linear.M), known.S_sd
    bias, bias_sd = -S @ linear.b, known.bias_mg_sd * MG
    axes = list(enumerate("xyz"))
    found = [("bias", a, "", bias[k], bias_sd[k]) for k, a in axes]
    found += [("scale", a, "", S[k, k] - 1.0, S_sd[k, k]) for k, a in axes]
    found += [
        ("misalignment", a, to, S[k, j], S_sd[k, j]) for k, a in axes for j, to in axes if j != k
    ]
    names = _COLUMNS.split()
    rows = [
        dict(zip(names, (term, a, to, f"{value:.9g}", f"{sd:.6g}", _UNITS[term]), strict=False))
        for term, a, to, value, sd in found
    ]
    sizes = {"bias": bias_sd, "scale": np.diag(S_sd), "misalignment": S_sd[~np.eye(3, dtype=bool)]}
    rows += [
        {
            "term": term,
            "axis": over,
            "sd": f"{_rms(sizes[term], over):.6g}",
            "unit": _UNITS[term],
            "code": code,
            "weight_function": weight,
            "propagation": "systematic",
        }
        for code, weight, term, over in _CODES
    ]
    lost = [
        "what drifts after the calibration, shocks, and temperatures and pressures of the hole "
        "that it did not see",
    ]
    if "mounting" not in calibration.model()[0].names:
        lost.append("the turn of the sensor in the tool: this calibration saw no tool's axes")
    lost += lost_linear(calibration, linear)
    out = StringIO()
    said = "Rows without a code: what was found, and its sd. With a code: 1 sd left once corrected."
    out.writelines(f"{line}\n" for line in heading(calibration, filename, lost, said))
    writer = csv.DictWriter(out, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return Made(out.getvalue(), tuple(lost), linear.mean)


def _rms(sd: Array, axes: str) -> float:
    """Over the axes that a code weighs; misalignments are of all."""
    of = sd if axes == "xyz" else sd[["xyz".index(a) for a in axes]]
    return float(np.sqrt(np.mean(of**2)))


EXPORT = Export("iscwsa-csv", "imucal_iscwsa.csv", iscwsa)
