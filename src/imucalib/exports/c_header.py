"""A C header for the firmware: `c_header.h.j2`, filled in.

Its fixed point has no long double, no floating point and no shift of a negative number, so that
every compiler since C99 gives the same. Numbers are rounded to the nearest, halves away from zero,
and what does not fit is the largest that does.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import identity
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.core.sphere import even_directions
from imucalib.errors import UsageError
from imucalib.exports import Export, Made
from imucalib.exports.imus import lost_of, lost_rates, places_of
from imucalib.exports.nearest import lost_linear, nearest_linear, sphere_of
from imucalib.recording.identity import NAMELESS
from imucalib.units import DEG, STANDARD_GRAVITY

#: Readings that the header tests itself with: the six faces, none, and one between the axes.
_TEST_READINGS = np.array([*np.eye(3), *(0.0 - np.eye(3)), np.zeros(3), [0.6, -0.48, 0.64]])


@dataclass(frozen=True)
class CFormula:
    """corrected = M raw + b of one sensor, or of K with K in front of the shapes.

    name : what follows `imucal_` in C's names, with an underscore at its end, or empty
    M, b, sd : (3, 3), (3,), (3,) or None, the last two in `unit`
    fine, coarse : counts that are one `unit` in 32 and in 16 bits; size : `unit`, of a test reading
    """

    name: str
    M: Array
    b: Array
    sd: Array | None
    unit: str
    fine: int
    coarse: int
    size: float

    @property
    def test_raw(self) -> Array:
        """(8, 3) in `unit`"""
        return _TEST_READINGS * self.size

    @property
    def test_corrected(self) -> Array:
        """(8, 3), what is due then"""
        return self.test_raw @ np.swapaxes(self.M, -1, -2) + self.b[..., None, :]


def c_header(calibration: Calibration, filename: str) -> Made:
    """corrected = M raw + b in g as float, in 32 and in 16 bits, with the functions that apply it,
    its standard deviation, a test of itself, and the calibration's SHA-256; of an array for every
    IMU, its gyro (deg/s) and its place.

    Raises UsageError when a coefficient passes fixed point.
    """
    if calibration.triads:
        corrections, places = _of_array(calibration), places_of(calibration)
        lost, loss, rate_loss = lost_of(calibration, ())
    else:
        corrections, lost, loss = _of_one(calibration)
        rate_loss, places = 0.0, np.zeros((0, 3))
    for one in corrections:
        _demand_fixed_point(one)
    text = _fill(
        {
            "filename": filename,
            "sensor": calibration.sensor or NAMELESS,
            "p": _prefix(calibration),
            "status": calibration.status,
            "lost": lost,
            "sha256": identity(calibration),
            "g_per_raw": calibration.raw_to_si / STANDARD_GRAVITY,
            "raw_unit": calibration.raw_unit,
            "imus": [t.name for t in calibration.triads],
            "places": places,
            "corrections": corrections,
            "table": _table,
        }
    )
    return Made(text, lost, loss, rate_loss)


def _prefix(calibration: Calibration) -> str:
    """What all C's names begin with: "imucal_", and the sensor's name where it has one."""
    name = (calibration.sensor or NAMELESS).name
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower()
    return f"imucal_{word or identity(calibration)[:8]}_" if name else "imucal_"


def _fill(values: Mapping[str, Any]) -> str:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    made = Environment(
        loader=PackageLoader("imucalib", "exports"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return made.get_template("c_header.h.j2").render(values)


def _of_one(calibration: Calibration) -> tuple[list[CFormula], tuple[str, ...], float]:
    """With what it loses, in words and in mg."""
    linear = nearest_linear(calibration)
    lost = lost_linear(calibration, linear, "; M and b are the nearest there")
    seen = sphere_of(calibration)
    spread = calibration.force_covariance(seen.force, seen.context)
    every = [_acceleration(linear.M, linear.b, _largest_sd(spread))]
    if (gyro := gyroscope_of(calibration)) is not None:
        every.append(_rate(gyro.gain, -(gyro.gain @ gyro.bias)))
        lost += lost_rates(calibration)
    return every, lost, linear.mean


def _of_array(calibration: Calibration) -> list[CFormula]:
    """Readings turned into board axes by the correction itself."""
    triads = calibration.triads
    one = STANDARD_GRAVITY * even_directions(600)
    M = np.array([np.linalg.inv(t.gain) @ t.rotation for t in triads])
    b = np.array([-np.linalg.inv(t.gain) @ t.bias for t in triads])
    sd = np.array([_largest_sd(t.force_covariance(one)) for t in triads])
    turn = np.array([np.linalg.inv(t.gyro_gain) @ t.rotation for t in triads])
    rest = np.array([-np.linalg.inv(t.gyro_gain) @ t.gyro_bias for t in triads])
    return [_acceleration(M, b, sd), _rate(turn, rest)]


def _acceleration(M: Array, b: Array, sd: Array) -> CFormula:
    """b and sd in m/s²; ug in 32 bits, and up to 16 g in 16."""
    b, sd = b / STANDARD_GRAVITY, sd / STANDARD_GRAVITY
    return CFormula("", M, b, sd, unit="g", fine=1000000, coarse=2048, size=1.0)


def _rate(M: Array, b: Array) -> CFormula:
    """b in rad/s; 10 µdeg/s in 32 bits, and a tenth of a deg/s in 16."""
    return CFormula("gyro_", M, b / DEG, None, unit="deg/s", fine=100000, coarse=10, size=100.0)


def _demand_fixed_point(one: CFormula) -> None:
    """Raise UsageError when a coefficient passes it."""
    # Three products of 16 bits stay in 32 when a row of |M| adds up to less than four.
    if np.abs(one.M).max() >= 1.9999 or np.abs(one.M).sum(axis=-1).max() >= 3.99:
        raise UsageError("the coefficients do not fit fixed point", remedy="check the unit")
    largest = np.abs(one.b).max()
    if largest * one.fine >= 2**31 - 1 or largest * one.coarse >= 2**15 - 1:
        raise UsageError("the offset does not fit fixed point", remedy="check the unit")


def _largest_sd(covariance: Array) -> Array:
    """(3,) m/s², the largest over forces (n, 3, 3), each axis by itself."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("nii->ni", covariance), 0.0)).max(axis=0))


def _table(kind: str, name: str, values: Array) -> str:
    """A table of C; integers are rounded."""

    def braced(part: Array) -> str:
        inner = map(number, part) if part.ndim == 1 else map(braced, part)
        return f"{{{', '.join(inner)}}}"

    def number(value: float) -> str:
        return f"{value:.9e}f" if kind == "float" else str(int(np.rint(value)))

    shape = "".join(f"[{n}]" for n in values.shape)
    return f"static const {kind} {name}{shape} = {braced(values)};"


EXPORT = Export("c-header", "imucal_calibration.h", c_header)
