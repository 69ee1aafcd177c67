"""Open Movement's omconvert with a given calibration, for the .cwa files of one Axivity device."""

from __future__ import annotations

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.per_axis import demand_one, heading, lost_per_axis, nearest_row


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
    lines = [
        "#!/bin/sh",
        *heading(calibration, filename),
        "#   sh imucal_omconvert.sh RECORDING.cwa -out RECORDING.wav",
        *(f"# Not in it: {text}." for text in lost),
        'exec omconvert "$@" -calibrate 0 \\',
        f"  -calibration {','.join(f'{v:.9g}' for v in numbers)}",
        "",
    ]
    return Made("\n".join(lines), lost, row.lost)


EXPORT = Export("omconvert", "imucal_omconvert.sh", omconvert)
