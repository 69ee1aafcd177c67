"""Frames of an array, as ROS names them: where each lies in the board, and how it is turned."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.exports.imus import imus_of

BOARD = "board"
WHAT = (
    "imuK: readings corrected by imucal, in board axes at the IMU's place; imuK_package: the "
    "IMU's own axes; fused: the virtual IMU, in the middle"
)
#: What every form of frames has no place for.
LOST = ("gains, biases and noise: a frame has none",)


@dataclass(frozen=True)
class ImuFrame:
    """place : (3,) m in the board's frame; turn : (3, 3) from the frame's axes to the board's"""

    name: str
    place: Array
    turn: Array


def frames_of(calibration: Calibration, form: str) -> tuple[ImuFrame, ...]:
    """Two an IMU, and that of the virtual IMU. Raises as `imus_of`."""
    imus = imus_of(calibration, form)
    made = []
    for imu in imus:
        made.append(ImuFrame(imu.name, imu.place, np.eye(3)))
        made.append(ImuFrame(f"{imu.name}_package", imu.place, imu.frame.T))
    middle = np.mean([imu.place for imu in imus], axis=0)
    return (*made, ImuFrame("fused", middle, np.eye(3)))


def in_comment(calibration: Calibration, filename: str) -> str:
    """What an XML file says of itself: two hyphens would end the comment."""
    said = f"Frames of an array by imucal, from {filename}, status {calibration.status}. {WHAT}."
    return said.replace("--", "- -").replace("--", "- -")
