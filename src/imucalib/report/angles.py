"""Angles of a corrected recording as a table file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucalib.atomic_file import replaced_atomically
from imucalib.calibration.angles import Angles
from imucalib.calibrators.lab.conventions import Conventions

_COLUMNS = (
    ("time_s", "%.6f"), ("inclination_deg", "%.4f"), ("inclination_sd_deg", "%.4f"),
    ("inclination_calibration_sd_deg", "%.4f"), ("tool_face_deg", "%.4f"),
    ("tool_face_sd_deg", "%.4f"), ("tool_face_calibration_sd_deg", "%.4f"),
    ("norm_error_mg", "%.3f"), ("still", "%d"),
)  # fmt: skip


def write_angles(found: Angles, conventions: Conventions, path: Path) -> None:
    """One row a sample or rest, CSV, angles in the bench's conventions; "nan" for a tool-face near
    the vertical."""
    inclination, tool_face = conventions.outside(found.inclination, found.tool_face)
    rows = np.column_stack([
        found.t, inclination, found.inclination_sd, found.inclination_calibration_sd, tool_face,
        found.tool_face_sd, found.tool_face_calibration_sd, found.norm_error, found.still,
    ])  # fmt: skip
    header = ",".join(name for name, _ in _COLUMNS)
    with replaced_atomically(path) as temporary:
        np.savetxt(temporary, rows, delimiter=",", header=header, comments="",
                   fmt=[form for _, form in _COLUMNS])  # fmt: skip
