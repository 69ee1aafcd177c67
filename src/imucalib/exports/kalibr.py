"""Kalibr's IMUs: noise as its imu.yaml has it, and what its results say of intrinsics."""

from __future__ import annotations

from typing import Any

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import Imu, file_an_imu
from imucalib.recording.yaml_text import dump


def kalibr(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model scale-misalignment-size-effect (ethz-asl/kalibr, IccSensors.py):
    reading = M C_i_b f + b, rate reading = M C_gyro_i C_i_b ω + A C_gyro_i C_i_b f + b.

    Kalibr's ImuParameters read six keys, all positive (ConfigReader.py); the body is the board.
    Raises as `file_an_imu`.
    """

    def text(imu: Imu, noise: dict[str, Any], said: list[str]) -> str:
        lines = [
            f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units.",
            "# Kalibr reads rostopic, update_rate and the four of the noise, and estimates what",
            "# stands below by itself. T_i_b takes places in the board's frame into the IMU's.",
            *said,
        ]
        return "\n".join([*lines, dump({**noise, **_block(imu)})])

    return file_an_imu(calibration, "Kalibr", text)


def _block(imu: Imu) -> dict[str, Any]:
    return {
        "T_i_b": imu.from_board.tolist(),
        "time_offset": 0.0,
        "model": "scale-misalignment-size-effect",
        "accelerometers": {
            "M": imu.accelerometer.tolist(),
            **{f"r{axis}_i": imu.elements[k].tolist() for k, axis in enumerate("xyz")},
        },
        "gyroscopes": {
            "M": imu.gyro.tolist(),
            "A": imu.by_force.tolist(),
            "C_gyro_i": imu.gyro_turn.tolist(),
        },
    }


EXPORT = Export("kalibr", "imu_kalibr.yaml", kalibr)
