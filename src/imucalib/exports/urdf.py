"""An array as a robot's part: URDF links with fixed joints."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.frames import BOARD, LOST, ImuFrame, frames_of, in_comment


def urdf(calibration: Calibration, filename: str) -> Made:
    """A link a frame, joined to the board: xyz in m, rpy in rad about the fixed axes x, y and z.
    Raises as `imus_of`."""
    frames = frames_of(calibration, "urdf")
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- {in_comment(calibration, filename)} -->",
        '<robot name="imu_array">',
        f'  <link name="{BOARD}"/>',
        *map(_join, frames),
        "</robot>",
        "",
    ]
    return Made("\n".join(lines), LOST)


def _join(frame: ImuFrame) -> str:
    from scipy.spatial.transform import Rotation

    angles = Rotation.from_matrix(frame.turn).as_euler("xyz")
    xyz, rpy = (" ".join(f"{v:.9g}" for v in values) for values in (frame.place, angles))
    name, joint = quoteattr(frame.name), quoteattr(f"{frame.name}_joint")
    return (
        f"  <link name={name}/>\n"
        f'  <joint name={joint} type="fixed">\n'
        f'    <parent link="{BOARD}"/>\n'
        f"    <child link={name}/>\n"
        f'    <origin xyz="{xyz}" rpy="{rpy}"/>\n'
        "  </joint>"
    )


EXPORT = Export("urdf", "imu_array.urdf", urdf)
