"""The calibration.json of a RealSense camera's IMU."""

from __future__ import annotations

import json

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.exports import Export, Made
from imucalib.exports.imus import lost_rates
from imucalib.exports.linear import lost_linear, nearest_linear
from imucalib.exports.per_axis import demand_one

#: In what the numbers act on (librealsense, src/proc/motion-transform.cpp).
_READINGS = "m/s2 and rad/s as read with enable_motion_correction 0, in the axes of the depth image"


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


EXPORT = Export("realsense", "calibration.json", realsense)
