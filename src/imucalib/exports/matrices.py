"""A matrix and a vector of each sensor: for the ROS package imu_calib, which others took over,
for a RealSense camera, and for MATLAB and Octave."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.exports import Export, Made
from imucalib.exports.imus import common_delay, lost_of, lost_rates, places_of
from imucalib.exports.nearest import demand_one, heading, lost_linear, nearest_linear
from imucalib.recording.yaml_text import dump

#: In what the numbers act on (librealsense, src/proc/motion-transform.cpp).
_READINGS = "m/s2 and rad/s as read with enable_motion_correction 0, in the axes of the depth image"


def imu_calib(calibration: Calibration, filename: str) -> Made:
    """SM (nine numbers, row by row) and bias (m/s²): corrected = SM reading - bias
    (dpkoch/imu_calib, accel_calib.cpp). Its node takes the gyroscope's bias from the first samples
    of a start, and has no place for more. Raises UsageError for an array.
    """
    demand_one(calibration, "imu_calib")
    linear = nearest_linear(calibration)
    lost = lost_linear(calibration, linear)
    if gyroscope_of(calibration) is not None:
        lost += ("the gyroscope, whose bias imu_calib takes from the first samples of every start",)
    lines = [
        *heading(calibration, filename, lost, "corrected = SM reading - bias, m/s2."),
        dump({"SM": linear.M.ravel().tolist(), "bias": (-linear.b).tolist()}),
    ]
    return Made("\n".join(lines), lost, linear.mean)


def realsense(calibration: Calibration, filename: str) -> Made:
    """Four rows of three numbers a sensor, X: corrected = (x, y, z, -1) X, in m/s² and rad/s, the
    first three rows in scale_and_alignment and the last in bias (IntelRealSense/librealsense,
    tools/rs-imu-calibration: check_X and what it saves, which the camera applies as
    sensitivity * xyz - bias). JSON has no comments: what is said of it stands in keys of its own.
    Raises UsageError for an array.
    """
    demand_one(calibration, "RealSense")
    linear, gyro = nearest_linear(calibration), gyroscope_of(calibration)
    lost = lost_linear(calibration, linear) + lost_rates(calibration)
    turn, off = np.eye(3), np.zeros(3)
    if gyro is not None:
        turn, off = gyro.gain, gyro.gain @ gyro.bias
    imu = {"accelerometer": _rows(linear.M, -linear.b), "gyroscope": _rows(turn, off)}
    content = {
        "made_by": f"imucal, from {filename}, status {calibration.status}",
        "readings": _READINGS,
        "not_in_it": lost,
        "device_type": "D435i",
        "imus": [imu],
    }
    return Made(json.dumps(content, indent=4, ensure_ascii=False) + "\n", lost, linear.mean)


def _rows(turn: Array, off: Array) -> dict[str, list[float]]:
    return {"scale_and_alignment": turn.T.ravel().tolist(), "bias": off.tolist()}


def matlab(calibration: Calibration, filename: str) -> Made:
    """Of one accelerometer M and b (m/s²): corrected = M * reading + b, columns, and of its
    gyroscope the same with the delay (s). Of an array those
    of every IMU along the third dimension, with its gyros' (rad/s), its positions (m) and their
    covariance (m²), and the gyros' delay (s)."""
    body = _of_array(calibration) if calibration.triads else _of_one(calibration)
    lines = [
        f"% Calibration by imucal, from {filename}, status {calibration.status}. SI units.",
        "% corrected = M * reading + b, reading a column.",
        *(f"% Not in it: {text}." for text in body.lost),
        body.text,
        "",
    ]
    return replace(body, text="\n".join(lines))


def _of_one(calibration: Calibration) -> Made:
    linear = nearest_linear(calibration)
    lost = lost_linear(calibration, linear)
    text = f"M = {_matrix(linear.M)};\nb = {_matrix(linear.b[:, None])};"
    gyro = gyroscope_of(calibration)
    if gyro is not None:
        text += (
            "\n% rate = gyro_K * (reading - gyro_b - gyro_G * corrected), rad/s."
            f"\ngyro_K = {_matrix(gyro.gain)};\ngyro_b = {_matrix(gyro.bias[:, None])};"
            f"\ngyro_G = {_matrix(gyro.by_force)};\n{_delay(calibration)}"
        )
        lost += lost_rates(calibration, ("gyro_g_sensitivity",), delay=True)
    return Made(text, lost, linear.mean)


def _of_array(calibration: Calibration) -> Made:
    names = ", ".join(f"'{t.name}'" for t in calibration.triads)
    lines = [
        "% Corrected vectors are in board axes; force = s + (W*W + dW) * r of each IMU, W and dW",
        "% the cross-product matrices of the rate and of its derivative.",
        f"names = {{{names}}};",
    ]
    for k, triad in enumerate(calibration.triads, 1):
        back, gyro_back = np.linalg.inv(triad.gain), np.linalg.inv(triad.gyro_gain)
        for name, value in (
            ("M", back @ triad.rotation),
            ("gyro_M", gyro_back @ triad.rotation),
        ):
            lines.append(f"{name}(:,:,{k}) = {_matrix(value)};")
        for name, value in (("b", -back @ triad.bias), ("gyro_b", -gyro_back @ triad.gyro_bias)):
            lines.append(f"{name}(:,{k}) = {_matrix(value[:, None])};")
    rows = [i for i, p in enumerate(calibration.parameters) if p.effect == "positions"]
    covariance = 1e-6 * calibration.covariance[np.ix_(rows, rows)]
    lines += [
        f"r = {_matrix(places_of(calibration).T)};",
        "% Covariance of r(:,2:end)(:), the first IMU being the reference.",
        f"r_covariance = {_matrix(covariance)};",
        _delay(calibration),
    ]
    return Made("\n".join(lines), *lost_of(calibration, (), delay=True))


def _delay(calibration: Calibration) -> str:
    return f"gyro_delay = {common_delay(calibration):.9g};"


def _matrix(values: Array) -> str:
    return "[" + "; ".join(" ".join(f"{v:.17g}" for v in row) for row in values) + "]"


IMU_CALIB = Export("imu-calib", "imu_calib.yaml", imu_calib)
REALSENSE = Export("realsense", "calibration.json", realsense)
MATLAB = Export("matlab", "imucal_calibration.m", matlab)
