"""The mark that `apply` leaves in a recording, and what it forbids."""

from __future__ import annotations

import hashlib

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import to_yaml
from imucalib.errors import UsageError
from imucalib.recording.recording import Correction, Recording


def identity(calibration: Calibration) -> str:
    """SHA-256 of a calibration's file; one that was not read from a file is hashed as it would be
    written."""
    return calibration.sha256 or hashlib.sha256(to_yaml(calibration).encode()).hexdigest()


def mark_of(calibration: Calibration, triad: str) -> Correction:
    """The mark of a calibration."""
    return Correction(triad, calibration.calibrator, identity(calibration))


def refuse_second(recording: Recording, triad: str) -> None:
    """Raise UsageError when the sensor is corrected already.

    A mark whose sensor the recording does not have, since it was renamed, may be any of them.
    """
    present = {c.triad for c in recording.channels.values()}
    for mark in recording.corrections:
        if mark.triad == triad or mark.triad not in present:
            raise UsageError(
                str(mark),
                where=recording.path,
                remedy="correct the recording that it was made from, or insist with --again",
            )
