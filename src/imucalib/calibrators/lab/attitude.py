"""Errors as a drilling engineer reads them: inclination, tool-face and the size of gravity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.core.references import angles_of
from imucalib.loop.held_out import Held
from imucalib.units import DEG, MG

#: Below this cosine of the inclination (about 3 degrees from vertical) tool-face has no meaning.
_LEAST_COSINE = 0.05


@dataclass(frozen=True)
class AttitudeErrors:
    """Corrected against expected, for each position.

    inclination, tool_face : (n,) deg in the table's sense, tool_face NaN near the vertical
    norm : (n,) mg
    """

    inclination: Array
    tool_face: Array
    norm: Array

    def take(self, rows: NDArray[np.intp]) -> AttitudeErrors:
        return AttitudeErrors(self.inclination[rows], self.tool_face[rows], self.norm[rows])


def attitude_errors(held: Held, conventions: Conventions) -> AttitudeErrors:
    """Angles are compared on vectors, unfolded, so that 91 degrees is not read as 89; sizes with
    what is expected, which is not gravity where a swing of the bench is known."""
    corrected, expected = held.corrected[:, 0], held.expected[:, 0]
    i, t = angles_of(corrected)
    i0, t0 = angles_of(expected)
    turn = np.mod(t - t0 + np.pi, 2.0 * np.pi) - np.pi
    folded = np.abs(turn) > np.pi / 2.0
    steep = np.abs(np.sin(i0)) > 0.7
    i = np.where(folded & steep, np.sign(i) * np.pi - i, i)
    turn = np.where(folded & steep, np.mod(turn, 2.0 * np.pi) - np.pi, turn)
    tool_face = np.where(np.abs(np.cos(i0)) > _LEAST_COSINE, turn / DEG, np.nan)
    norm = (np.linalg.norm(corrected, axis=1) - np.linalg.norm(expected, axis=1)) / MG
    senses = conventions.senses
    return AttitudeErrors(senses[0] * (i - i0) / DEG, senses[1] * tool_face, norm)


def worst(values: Array) -> float:
    """Largest absolute value, NaN left out; 0 for nothing."""
    used = np.abs(values[np.isfinite(values)])
    return float(used.max()) if used.size else 0.0


def rms(values: Array) -> float:
    """Root mean square, NaN left out; 0 for nothing."""
    used = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(used**2))) if used.size else 0.0
