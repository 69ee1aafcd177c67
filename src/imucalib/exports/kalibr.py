"""Kalibr's IMUs: noise as its imu.yaml has it, and what its results say of intrinsics."""

from __future__ import annotations

from typing import Any

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made, of_each
from imucalib.exports.imus import Imu, imus_of, losses_of, lost_of, lost_to_filters, noise_lines
from imucalib.recording.yaml_text import dump


def kalibr(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model scale-misalignment-size-effect (ethz-asl/kalibr, IccSensors.py):
    reading = M C_i_b f + b, rate reading = M C_gyro_i C_i_b ω + A C_gyro_i C_i_b f + b.

    Kalibr's ImuParameters read six keys, all positive (ConfigReader.py); the body is the board.
    Raises as `imus_of` and `noise_lines`.
    """
    imus = imus_of(calibration, "Kalibr")
    lost = (*lost_to_filters(calibration, "Kalibr"), *lost_of(calibration))
    files = {}
    for imu in imus:
        noise, said = noise_lines(imu, "Kalibr")
        lines = [
            f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units.",
            "# Kalibr reads rostopic, update_rate and the four of the noise, and estimates what",
            "# stands below by itself. T_i_b takes places in the board's frame into the IMU's.",
            *said,
            *(f"# Not in it: {text}." for text in lost),
        ]
        files[imu.name] = "\n".join([*lines, dump({**noise, **_block(imu)})])
    return of_each(files, lost, losses_of(calibration))


def _block(imu: Imu) -> dict[str, Any]:
    return {
        "T_i_b": rows(imu.from_board),
        "time_offset": 0.0,
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


EXPORT = Export("kalibr", "imu_kalibr.yaml", kalibr)
