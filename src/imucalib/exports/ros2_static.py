"""Static transforms of an array for ROS 2: a launch file."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.frames import BOARD, LOST, WHAT, Frame, frames_of


def ros2_static(calibration: Calibration, filename: str) -> Made:
    """A static_transform_publisher of tf2_ros a frame, from the board to it: x, y, z in m, and the
    quaternion that turns the frame's axes into the board's. Raises as `imus_of`."""
    frames = frames_of(calibration, "ros2-static")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- Frames of an array by imucal, from {_comment(filename)}, status "
        f"{calibration.status}. {WHAT}. -->",
        "<launch>",
        *map(_node, frames),
        "</launch>",
        "",
    ]
    return Made("\n".join(lines), LOST)


def _comment(text: str) -> str:
    """Text that may stand in a comment."""
    return text.replace("--", "- -")


def _node(frame: Frame) -> str:
    from scipy.spatial.transform import Rotation

    numbers = (*frame.place, *Rotation.from_matrix(frame.turn).as_quat())
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    given = " ".join(f"--{n} {v:.9g}" for n, v in zip(names, numbers, strict=True))
    arguments = f"{given} --frame-id {BOARD} --child-frame-id {frame.name}"
    return (
        f'  <node pkg="tf2_ros" exec="static_transform_publisher" '
        f"name={quoteattr(f'{BOARD}_to_{frame.name}')} args={quoteattr(arguments)}/>"
    )


EXPORT = Export("ros2-static", "static_transforms.launch.xml", ros2_static)
