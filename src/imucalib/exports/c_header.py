"""A C header for the firmware."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.errors import UsageError
from imucalib.exports import Export
from imucalib.exports.imus import places_of
from imucalib.exports.linear import beyond_linear, lost_parts, nearest_linear
from imucalib.units import DEG, MG, STANDARD_GRAVITY


def c_header(calibration: Calibration, filename: str) -> tuple[str, tuple[str, ...]]:
    """M and b for raw readings in g, as float, Q31 and Q15; of an array, those of every IMU.

    Fixed point holds M - 1 and b, which are below 1, so that no bit is spent on the integer part:
    corrected = raw + (dM raw + b). Raises UsageError when an entry is 1 or more.
    """
    body, lost = _of_array(calibration) if calibration.triads else _of_one(calibration)
    lines = [
        "/* Accelerometer calibration by imucal: corrected = M * raw + b, in g.",
        f" * From {filename}, status {calibration.status}.",
        *(f" * Not in it: {text}." for text in lost),
        " * Fixed point: corrected = raw + dM * raw + b, dM = M - 1; raw itself needs a wider",
        " * type than Q15 or Q31, which end below 1 g. */",
        "#ifndef IMUCAL_CALIBRATION_H",
        "#define IMUCAL_CALIBRATION_H",
        "#include <stdint.h>",
        "",
        *body,
    ]
    return "\n".join([*lines, "", "#endif", ""]), lost


def _of_one(calibration: Calibration) -> tuple[list[str], tuple[str, ...]]:
    linear = nearest_linear(calibration)
    change, offset = linear.M - np.eye(3), linear.b / STANDARD_GRAVITY
    if max(np.abs(change).max(), np.abs(offset).max()) >= 1.0:
        raise UsageError("the coefficients do not fit fixed point", remedy="check the unit")
    lines = [
        _array("float", "imucal_M", linear.M, _float),
        _array("float", "imucal_b", offset, _float),
    ]
    for bits, kind in ((31, "int32_t"), (15, "int16_t")):

        def fixed(value: float, bits: int = bits) -> str:
            return str(round(value * (1 << bits)))

        lines.append(_array(kind, f"imucal_dM_q{bits}", change, fixed))
        lines.append(_array(kind, f"imucal_b_q{bits}", offset, fixed))
    lost = lost_parts(calibration)
    if names := beyond_linear(calibration):
        lost = (
            f"{names}: {linear.mean:.2f} mg on average over the sphere and the calibrated ranges, "
            f"{linear.worst:.2f} mg at most; M and b are the nearest there",
            *lost,
        )
    return lines, lost


def _of_array(calibration: Calibration) -> tuple[list[str], tuple[str, ...]]:
    """Readings turned into board axes by the correction itself."""
    M = np.array([np.linalg.inv(t.gain) @ t.rotation for t in calibration.triads])
    b = np.array([-np.linalg.inv(t.gain) @ t.bias for t in calibration.triads]) / STANDARD_GRAVITY
    gyro = np.array([np.linalg.inv(t.gyro_gain) @ t.rotation for t in calibration.triads])
    rest = np.array([-np.linalg.inv(t.gyro_gain) @ t.gyro_bias for t in calibration.triads])
    names = ", ".join(t.name for t in calibration.triads)
    lines = [
        f"/* IMUs in this order: {names}. Corrected vectors are in board axes; rates in deg/s. */",
        _array("float", "imucal_M", M, _float),
        _array("float", "imucal_b", b, _float),
        _array("float", "imucal_gyro_M", gyro, _float),
        _array("float", "imucal_gyro_b", rest / DEG, _float),
        "/* Places of the IMUs in the board's frame, m. */",
        _array("float", "imucal_r", places_of(calibration), _float),
    ]
    lost = tuple(
        f"{row['effect']}, {_in_mg(float(row['rms']), str(row['unit']))} rms in the "
        "motion that was calibrated"
        for row in calibration.facts.get("not_undone", ())
    )
    return lines, lost


def _in_mg(value: float, unit: str) -> str:
    return f"{value / MG:.2f} mg" if unit == "m/s²" else f"{value:.3g} {unit}"


def _float(value: float) -> str:
    return f"{value:.9e}f"


def _array(kind: str, name: str, values: Array, text: Callable[[float], str]) -> str:
    def braced(part: Array) -> str:
        inner = [text(float(v)) for v in part] if part.ndim == 1 else [braced(p) for p in part]
        return f"{{{', '.join(inner)}}}"

    shape = "".join(f"[{n}]" for n in values.shape)
    return f"static const {kind} {name}{shape} = {braced(values)};"


EXPORT = Export("c-header", "imucal_calibration.h", c_header)
