"""Worn accelerometers: GGIR's back-up table of coefficients, and Open Movement's omconvert with a
given calibration, for the .cwa files of one Axivity device."""

from __future__ import annotations

import csv
from io import StringIO

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.nearest import demand_one, heading, lost_per_axis, nearest_row
from imucalib.recording.pairing import cell


def ggir_csv(calibration: Calibration, filename: str) -> Made:
    """One row of GGIR's backup.cal.coef: corrected = scale * (raw + offset + tempoffset ΔT), in g.

    GGIR has no terms between the axes, so the row holds the numbers that come nearest over the
    postures and the temperatures that were recorded; their own mean error goes to
    cal.error.end with the calibration's. ΔT counts from meantempcal, the middle of those
    temperatures, where the offsets hold; before 3.0-5 GGIR took the mean of each recording
    (wadpac/GGIR, g.part1.R). Raises UsageError for an array.
    """
    demand_one(calibration, "a row of GGIR")
    row = nearest_row(calibration)
    start, end = (calibration.find_error({"mg": 1.0}, of) for of in ("raw", "final"))
    # Part 2 reads these of every row, as its own quality report has them; NA: not known.
    seen = calibration.facts.get("coverage", {})
    hours = f"{seen['hours']:.6g}" if "hours" in seen else "NA"
    others = {
        "n.10sec.windows": seen.get("still_windows", "NA"),
        "n.hours.considered": hours,
        "QCmessage": f"calibrated by imucal: {calibration.status}",
        "use.temperature": "TRUE" if np.any(row.slope) else "FALSE",
    }
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
    writer.writerow(["filename", *numbers, *others])
    known = (f"{v:.9g}" if np.isfinite(v) else "NA" for v in numbers.values())
    writer.writerow([cell(filename), *known, *others.values()])
    return Made(out.getvalue(), lost_per_axis(calibration, row, " (in cal.error.end)"), row.lost)


def omconvert(calibration: Calibration, filename: str) -> Made:
    """A shell script that calls omconvert with these coefficients in place of its own: corrected =
    (raw + offset) scale + tempoffset (T - reference), in g and °C (openmovement,
    Software/AX3/omconvert: omcalibrate.c, option -calibration of main.c).

    Raises UsageError for an array.
    """
    demand_one(calibration, "omconvert")
    row = nearest_row(calibration)
    lost = lost_per_axis(calibration, row)
    numbers = (*row.scale, *row.offset, *(row.scale * row.slope), row.middle)
    call = "  sh imucal_omconvert.sh RECORDING.cwa -out RECORDING.wav"
    lines = [
        "#!/bin/sh",
        *heading(calibration, filename, lost, call),
        'exec omconvert "$@" -calibrate 0 \\',
        f"  -calibration {','.join(f'{v:.9g}' for v in numbers)}",
        "",
    ]
    return Made("\n".join(lines), lost, row.lost)


GGIR = Export("ggir-csv", "ggir_calibration.csv", ggir_csv)
OMCONVERT = Export("omconvert", "imucal_omconvert.sh", omconvert)
