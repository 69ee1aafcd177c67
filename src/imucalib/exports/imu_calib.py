"""imu_calib.yaml of the ROS package imu_calib, which others have taken over."""

from __future__ import annotations

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.exports import Export, Made
from imucalib.exports.linear import lost_linear, nearest_linear
from imucalib.exports.per_axis import demand_one, heading
from imucalib.recording.yaml_text import dump


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
        *heading(calibration, filename),
        "# corrected = SM reading - bias, m/s2.",
        *(f"# Not in it: {text}." for text in lost),
        dump({"SM": linear.M.ravel().tolist(), "bias": (-linear.b).tolist()}),
    ]
    return Made("\n".join(lines), lost, linear.mean)


EXPORT = Export("imu-calib", "imu_calib.yaml", imu_calib)
