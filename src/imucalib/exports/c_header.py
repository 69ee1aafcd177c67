"""A C header for the firmware."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.file import identity
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.core.sphere import even_directions
from imucalib.exports import Export, Made
from imucalib.exports.c_functions import ROUNDED, Correction, array, functions, tables
from imucalib.exports.imus import losses_of, places_of
from imucalib.exports.linear import beyond_linear, lost_parts, nearest_linear, sphere_of
from imucalib.units import DEG, MG, STANDARD_GRAVITY


def c_header(calibration: Calibration, filename: str) -> Made:
    """corrected = M raw + b in g as float, in 32 and in 16 bits, with the functions that apply it,
    its standard deviation, a test of itself, and the calibration's SHA-256; of an array for every
    IMU, its gyro (deg/s) and its place.

    Raises UsageError when a coefficient passes fixed point.
    """
    body = _of_array(calibration) if calibration.triads else _of_one(calibration)
    lines = [
        "/* Accelerometer calibration by imucal: corrected = M * raw + b, in g.",
        f" * From {filename}, status {calibration.status}.",
        *(f" * Not in it: {text}." for text in body.lost),
        " * imucal_apply takes float, imucal_apply_fine 32 bits, imucal_apply_coarse 16;",
        " * imucal_self_test() is 0 where a machine does them right. imucal_sd is the largest",
        " * standard deviation of a corrected 1 g in any attitude, of the calibration alone. */",
        "#ifndef IMUCAL_CALIBRATION_H",
        "#define IMUCAL_CALIBRATION_H",
        "#include <stdint.h>",
        "#include <stdlib.h>",
        "",
        f'#define IMUCAL_ID "{identity(calibration)}" /* SHA-256 of calibration.yaml */',
        f'#define IMUCAL_STATUS "{calibration.status}"',
        f"#define IMUCAL_G_PER_RAW {calibration.raw_to_si / STANDARD_GRAVITY:.9e}f "
        f"/* readings of the calibration: {calibration.raw_unit} */",
        body.text,
    ]
    return replace(body, text="\n".join([*lines, "", "#endif", ""]))


def _of_one(calibration: Calibration) -> Made:
    linear = nearest_linear(calibration)
    one = _acceleration(linear.M[None], linear.b[None], _sd(calibration)[None], single=True)
    lost = lost_parts(calibration)
    if names := beyond_linear(calibration):
        lost = (
            f"{names}: {linear.mean:.2f} mg on average over the sphere and the calibrated ranges, "
            f"{linear.worst:.2f} mg at most; M and b are the nearest there",
            *lost,
        )
    every = [one]
    if (gyro := gyroscope_of(calibration)) is not None:
        every.append(_rate(gyro.gain[None], -(gyro.gain @ gyro.bias)[None], single=True))
        lost = (*lost, *gyro.beyond, *(["gyro_g_sensitivity"] if gyro.by_force.any() else []))
    made = [line for each in every for line in tables(each)]
    text = "\n".join([*made, "", ROUNDED, *(line for each in every for line in functions(each))])
    return Made(text, lost, linear.mean)


def _of_array(calibration: Calibration) -> Made:
    """Readings turned into board axes by the correction itself."""
    triads = calibration.triads
    M = np.array([np.linalg.inv(t.gain) @ t.rotation for t in triads])
    b = np.array([-np.linalg.inv(t.gain) @ t.bias for t in triads])
    sd = np.array([_triad_sd(t.gain, t.covariance) for t in triads])
    force = _acceleration(M, b, sd, single=False)
    turn = np.array([np.linalg.inv(t.gyro_gain) @ t.rotation for t in triads])
    rest = np.array([-np.linalg.inv(t.gyro_gain) @ t.gyro_bias for t in triads])
    rate = _rate(turn, rest, single=False)
    lines = [
        f"/* IMUs in this order: {', '.join(t.name for t in triads)}. */",
        "/* Corrected vectors are in board axes. */",
        *tables(force),
        *tables(rate),
        "/* Places of the IMUs in the board's frame, m. */",
        array("float", "imucal_r", places_of(calibration)),
        "",
        ROUNDED,
        *functions(force),
        *functions(rate),
    ]
    lost = tuple(
        f"{row['effect']}, {_in_mg(float(row['rms']), str(row['unit']))} rms in the "
        "motion that was calibrated"
        for row in calibration.facts.get("not_undone", ())
    )
    return Made("\n".join(lines), lost, *losses_of(calibration, ()))


def _acceleration(M: Array, b: Array, sd: Array, *, single: bool) -> Correction:
    """b and sd in m/s²; ug in 32 bits, and up to 16 g in 16."""
    return Correction(
        name="",
        M=M,
        b=b / STANDARD_GRAVITY,
        sd=sd / STANDARD_GRAVITY,
        unit="g",
        fine=1000000,
        coarse=2048,
        size=1.0,
        single=single,
    )


def _rate(M: Array, b: Array, *, single: bool) -> Correction:
    """b in rad/s; 10 µdeg/s in 32 bits, and a tenth of a deg/s in 16."""
    return Correction(
        name="gyro_",
        M=M,
        b=b / DEG,
        sd=None,
        unit="deg/s",
        fine=100000,
        coarse=10,
        size=100.0,
        single=single,
    )


def _sd(calibration: Calibration) -> Array:
    """(3,) m/s², the largest of a corrected 1 g over the sphere and the calibrated ranges."""
    model, theta = calibration.model()
    seen = sphere_of(calibration)
    own = model.predict(theta, seen.force[:, None], seen.context)
    slope = np.asarray(np.linalg.solve(own.d_truth[:, 0], own.d_theta[:, 0]), np.float64)
    return _largest(slope, calibration.covariance_of(model))


def _triad_sd(gain: Array, covariance: Array) -> Array:
    """The same for an IMU whose force is gain⁻¹ (turned reading - bias)."""
    force = STANDARD_GRAVITY * even_directions(600)
    by_gain = np.einsum("ij,nk->nijk", np.eye(3), force).reshape(-1, 3, 9)
    by_bias = np.broadcast_to(np.eye(3), (len(force), 3, 3))
    slope = np.linalg.inv(gain) @ np.concatenate([by_gain, by_bias], axis=2)
    return _largest(slope, covariance)


def _largest(slope: Array, covariance: Array) -> Array:
    variance = np.einsum("nip,pq,niq->ni", slope, covariance, slope)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)).max(axis=0))


def _in_mg(value: float, unit: str) -> str:
    return f"{value / MG:.2f} mg" if unit == "m/s²" else f"{value:.3g} {unit}"


EXPORT = Export("c-header", "imucal_calibration.h", c_header)
