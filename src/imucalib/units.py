"""Units, converted once at the border: everything inside is SI (m/s², rad/s, °C, s).

Parameters that a person reads are in the field's units (mg, deg); the two factors that
connect them, `MG` and `DEG`, live here.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput, UsageError

STANDARD_GRAVITY = 9.80665  # m/s², exact by definition (3rd CGPM, 1901)
MG = STANDARD_GRAVITY * 1e-3  # m/s² in one mg
DEG = math.pi / 180.0  # rad in one degree

ACCELERATION_UNITS: dict[str, float] = {
    "m/s2": 1.0,
    "g": STANDARD_GRAVITY,
    "mg": MG,
    "ug": MG * 1e-3,
}
RATE_UNITS: dict[str, float] = {
    "rad/s": 1.0,
    "deg/s": DEG,
    "mrad/s": 1e-3,
    "mdeg/s": DEG * 1e-3,
}
ANGLE_UNITS: dict[str, float] = {"rad": 1.0, "deg": DEG, "mrad": 1e-3}

_BALANCED = re.compile(r"(?:[^()\[\]]|\([^()]*\)|\[[^\[\]]*\])*")
_SPELLINGS = {
    "m/s^2": "m/s2",
    "m/(s^2)": "m/s2",
    "m/(s2)": "m/s2",
    "m/(s*s)": "m/s2",
    "m/s²": "m/s2",
    "m s^-2": "m/s2",
    "m s-2": "m/s2",
    "ms-2": "m/s2",
    "m s⁻²": "m/s2",
    "m/s/s": "m/s2",
    "m*s^-2": "m/s2",
    "mps2": "m/s2",
    "gee": "g",
    "milli-g": "mg",
    "millig": "mg",
    "µg": "ug",
    "micro-g": "ug",
    "1e-6 g": "ug",
    "1e-3 g": "mg",
    "rad s^-1": "rad/s",
    "rad s-1": "rad/s",
    "rads-1": "rad/s",
    "rps": "rad/s",
    "deg s^-1": "deg/s",
    "degree s-1": "deg/s",
    "degrees s-1": "deg/s",
    "deg s-1": "deg/s",
    "degree/s": "deg/s",
    "degree s^-1": "deg/s",
    "rad/sec": "rad/s",
    "radians/s": "rad/s",
    "radian s-1": "rad/s",
    "dps": "deg/s",
    "d/s": "deg/s",
    "deg/sec": "deg/s",
    "°/s": "deg/s",
    "degrees/s": "deg/s",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "radians": "rad",
    "mdps": "mdeg/s",
}
_ALL = {**ACCELERATION_UNITS, **RATE_UNITS, **ANGLE_UNITS}


def strip_brackets(text: str) -> str:
    """The text without the pair of brackets around it: "[m/(s^2)]" is "m/(s^2)"."""
    text = text.strip()
    while text[:1] + text[-1:] in ("[]", "()") and _BALANCED.fullmatch(text[1:-1]):
        text = text[1:-1].strip()
    return text


def canonical(unit: str) -> str:
    """The one spelling of a unit that this package uses; unknown text comes back stripped."""
    text = strip_brackets(unit)
    low = text.lower().replace("**", "^")
    return _SPELLINGS.get(low, low if low in _ALL else text)


def factor(unit: str, family: dict[str, float], where: str = "") -> float:
    """SI units per `unit`, within a family of units; raises UsageError for an unknown unit."""
    known = canonical(unit)
    if known not in family:
        choices = ", ".join(family)
        raise UsageError(f"unknown unit '{unit}'", where=where, remedy=f"use one of: {choices}")
    return family[known]


@dataclass(frozen=True)
class DetectedUnit:
    """A unit inferred from the norm at rest, with the sentence that is shown to the user."""

    unit: str
    norm_at_rest: float
    sentence: str


def detect_acceleration_unit(
    norms_at_rest: NDArray[np.float64], where: str, tolerance: float = 0.25
) -> DetectedUnit:
    """Infer the acceleration unit from norms at rest (raw, one for each still interval).

    Gravity is the reference that every accelerometer at rest carries. The median norm must lie
    within `tolerance` (relative) of 1 g in exactly one known unit, otherwise UnreadableInput.
    """
    norm = float(np.median(norms_at_rest)) if norms_at_rest.size else math.nan
    for unit, si in ACCELERATION_UNITS.items():
        if abs(norm * si / STANDARD_GRAVITY - 1.0) <= tolerance:
            return DetectedUnit(unit, norm, f"norm at rest = {norm:.6g} -> unit {unit}")
    raise UnreadableInput(
        f"norm at rest = {norm:.6g} fits no known unit (g, mg, ug, m/s2)",
        where=where,
        remedy="name it with --unit; for counts give the data sheet's counts a g, near "
        f"--unit counts --lsb {norm:.0f}"
        if math.isfinite(norm)
        else "name it with --unit",
    )


def local_gravity(latitude_deg: float, height_m: float = 0.0) -> float:
    """Normal gravity (m/s²) at a geodetic latitude (deg) and height above the ellipsoid (m).

    WGS 84: Somigliana's closed form and the second-order free-air term (NIMA TR8350.2, 3rd ed.,
    eqs. 4-1 and 4-3). Local anomalies of up to about 0.1 mg remain. Raises UsageError when the
    latitude is outside [-90, 90].
    """
    if not -90.0 <= latitude_deg <= 90.0:
        raise UsageError(
            f"latitude {latitude_deg:g} is outside [-90, 90] degrees",
            remedy="give it in degrees, north of the equator positive",
        )
    gamma_e, k, e2 = 9.7803253359, 0.00193185265241, 0.00669437999014
    a, f, m = 6378137.0, 1.0 / 298.257223563, 0.00344978650684
    s2 = math.sin(latitude_deg * DEG) ** 2
    surface = gamma_e * (1.0 + k * s2) / math.sqrt(1.0 - e2 * s2)
    return surface * (
        1.0 - 2.0 / a * (1.0 + f + m - 2.0 * f * s2) * height_m + 3.0 * (height_m / a) ** 2
    )


def resolve_gravity(
    given: float | None, latitude: float | None, height: float
) -> tuple[float, str] | None:
    """Local gravity (m/s²) with its source in words, as stated or of a place (deg, m); None where
    neither is. Raises UsageError where both are."""
    if given is not None and latitude is not None:
        what = "a local gravity and a latitude exclude each other"
        raise UsageError(what, remedy="leave one out")
    if given is not None:
        return given, "as given"
    if latitude is None:
        return None
    source = f"normal gravity at latitude {latitude:g}, height {height:g} m"
    return local_gravity(latitude, height), source
