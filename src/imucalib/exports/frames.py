"""Frames of an array, as ROS names them: where each lies in the board, and how it is turned. URDF,
and static transforms for ROS 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from shlex import quote
from xml.sax.saxutils import quoteattr

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import imus_of

_BOARD = "board"
_WHAT = (
    "imuK: readings corrected by imucal, in board axes at the IMU's place; imuK_package: the "
    "IMU's own axes; fused: the virtual IMU, in the middle"
)


@dataclass(frozen=True)
class ImuFrame:
    """place : (3,) m in the board's frame; turn : (3, 3) from the frame's axes to the board's"""

    name: str
    place: Array
    turn: Array


def ros2_static(calibration: Calibration, filename: str) -> Made:
    """A static_transform_publisher of tf2_ros a frame, from the board to it: x, y, z in m, and the
    quaternion that turns the frame's axes into the board's. Raises as `imus_of`."""
    nodes = map(_node, frames_of(calibration, "ros2-static"))
    return _make_xml(calibration, filename, ["<launch>", *nodes, "</launch>"])


def _node(frame: ImuFrame) -> str:
    from scipy.spatial.transform import Rotation

    numbers = (*frame.place, *Rotation.from_matrix(frame.turn).as_quat())
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    given = " ".join(f"--{n} {v:.9g}" for n, v in zip(names, numbers, strict=True))
    arguments = f"{given} --frame-id {_BOARD} --child-frame-id {quote(frame.name)}"
    return (
        f'  <node pkg="tf2_ros" exec="static_transform_publisher" '
        f"name={quoteattr(f'{_BOARD}_to_{frame.name}')} args={quoteattr(arguments)}/>"
    )


def urdf(calibration: Calibration, filename: str) -> Made:
    """A link a frame, joined to the board: xyz in m, rpy in rad about the fixed axes x, y and z.
    Raises as `imus_of`."""
    joined = map(_join, frames_of(calibration, "urdf"))
    first = ('<robot name="imu_array">', f'  <link name="{_BOARD}"/>')
    return _make_xml(calibration, filename, [*first, *joined, "</robot>"])


def _join(frame: ImuFrame) -> str:
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(frame.turn).as_euler("xyz")
    xyz, rpy = (" ".join(f"{v:.9g}" for v in values) for values in (frame.place, angles))
    name, joint = quoteattr(frame.name), quoteattr(f"{frame.name}_joint")
    return (
        f"  <link name={name}/>\n"
        f'  <joint name={joint} type="fixed">\n'
        f'    <parent link="{_BOARD}"/>\n'
        f"    <child link={name}/>\n"
        f'    <origin xyz="{xyz}" rpy="{rpy}"/>\n'
        "  </joint>"
    )


def frames_of(calibration: Calibration, form: str) -> tuple[ImuFrame, ...]:
    """Two an IMU, and that of the virtual IMU. Raises as `imus_of`."""
    imus = imus_of(calibration, form)
    made = []
    for imu in imus:
        made.append(ImuFrame(imu.name, imu.place, np.eye(3)))
        made.append(ImuFrame(f"{imu.name}_package", imu.place, imu.frame.T))
    middle = np.mean([imu.place for imu in imus], axis=0)
    return (*made, ImuFrame("fused", middle, np.eye(3)))


def _make_xml(calibration: Calibration, filename: str, lines: Sequence[str]) -> Made:
    """An XML file that says of itself what it is: two hyphens would end the comment."""
    said = f"Frames of an array by imucal, from {filename}, status {calibration.status}. {_WHAT}."
    comment = said.replace("--", "- -").replace("--", "- -")
    head = ('<?xml version="1.0"?>', f"<!-- {comment} -->")
    return Made("\n".join([*head, *lines, ""]), ("gains, biases and noise: a frame has none",))


ROS2_STATIC = Export("ros2-static", "static_transforms.launch.xml", ros2_static)
URDF = Export("urdf", "imu_array.urdf", urdf)
