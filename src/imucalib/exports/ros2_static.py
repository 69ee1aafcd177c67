"""Static transforms of an array for ROS 2: a launch file."""

from __future__ import annotations

from shlex import quote
from xml.sax.saxutils import quoteattr

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.frames import BOARD, LOST, ImuFrame, frames_of, in_comment


def ros2_static(calibration: Calibration, filename: str) -> Made:
    """A static_transform_publisher of tf2_ros a frame, from the board to it: x, y, z in m, and the
    quaternion that turns the frame's axes into the board's. Raises as `imus_of`."""
    frames = frames_of(calibration, "ros2-static")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {in_comment(calibration, filename)} -->",
        "<launch>",
        *map(_node, frames),
        "</launch>",
        "",
    ]
    return Made("\n".join(lines), LOST)


def _node(frame: ImuFrame) -> str:
    from scipy.spatial.transform import Rotation

    numbers = (*frame.place, *Rotation.from_matrix(frame.turn).as_quat())
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    given = " ".join(f"--{n} {v:.9g}" for n, v in zip(names, numbers, strict=True))
    arguments = f"{given} --frame-id {BOARD} --child-frame-id {quote(frame.name)}"
    return (
        f'  <node pkg="tf2_ros" exec="static_transform_publisher" '
        f"name={quoteattr(f'{BOARD}_to_{frame.name}')} args={quoteattr(arguments)}/>"
    )


EXPORT = Export("ros2-static", "static_transforms.launch.xml", ros2_static)
