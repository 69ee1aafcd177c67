"""Kalibr's IMUs: intrinsics, extrinsics and noise, as its imu.yaml and its results have them."""

from __future__ import annotations

from typing import Any

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import Imu, force_lost, imus_of, lost_noise, lost_of, lost_to_filters
from imucalib.recording.yaml_text import dump


def kalibr(calibration: Calibration, filename: str) -> Made:
    """A block an IMU, model scale-misalignment-size-effect (ethz-asl/kalibr, IccSensors.py):
    reading = M C_i_b f + b, rate reading = M C_gyro_i C_i_b ω + A C_gyro_i C_i_b f + b.

    The body is the board. Raises as `imus_of`.
    """
    imus = imus_of(calibration, "Kalibr")
    lost = (*lost_to_filters(calibration, "Kalibr"), *lost_of(calibration), *lost_noise(imus))
    lines = [
        f"# IMUs of an array by imucal, from {filename}, status {calibration.status}.",
        "# SI units; T_i_b takes places in the board's frame into the IMU's. For Kalibr, one block",
        "# a file, without its name.",
        *(f"# Not in it: {text}." for text in lost),
    ]
    content = {imu.name: _block(imu) for imu in imus}
    return Made("\n".join([*lines, dump(content)]), lost, force_lost(calibration))


def _block(imu: Imu) -> dict[str, Any]:
    return {
        "T_i_b": rows(imu.from_board),
        "rostopic": f"/{imu.name}/imu",
        "time_offset": 0.0,
        **{key: value for key, value in imu.noise.items() if key != "rostopic"},
        "model": "scale-misalignment-size-effect",
        "accelerometers": {
            "M": rows(imu.accelerometer),
            **{f"r{axis}_i": imu.elements[k].tolist() for k, axis in enumerate("xyz")},
        },
        "gyroscopes": {
            "M": rows(imu.gyro),
            "A": rows(imu.by_force),
            "C_gyro_i": rows(imu.gyro_turn),
        },
    }


def rows(matrix: Array) -> list[list[float]]:
    """A matrix as YAML has it."""
    return [[float(v) for v in row] for row in matrix]


EXPORT = Export("kalibr", "imus_kalibr.yaml", kalibr)
