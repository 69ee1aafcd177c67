"""IMUs for programs that filter, and estimate biases by themselves: Kalibr, and OpenVINS with its
kalibr_imu_chain.yaml."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import Imu, imus_of, lost_of, noise_of
from imucalib.recording.yaml_text import dump

#: What every form of single IMUs loses of an array.
_KEPT = ("gyro_g_sensitivity", "sensing_elements")


def kalibr(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model scale-misalignment-size-effect (ethz-asl/kalibr, IccSensors.py):
    reading = M C_i_b f + b, rate reading = M C_gyro_i C_i_b ω + A C_gyro_i C_i_b f + b.

    Kalibr's ImuParameters read six keys, all positive (ConfigReader.py); the body is the board.
    Raises as `_file_an_imu`.
    """

    def text(imu: Imu, noise: dict[str, Any], said: list[str]) -> str:
        lines = [
            f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units.",
            "# Kalibr reads rostopic, update_rate and the four of the noise, and estimates what",
            "# stands below by itself. T_i_b takes places in the board's frame into the IMU's.",
            *said,
        ]
        return "\n".join([*lines, dump({**noise, **_block(imu)})])

    return _file_an_imu(calibration, "Kalibr", text)


def openvins(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model kalibr: reading = Ta R_IMUtoACC f + b, rate reading =
    Tw R_IMUtoGYRO ω + Tg f + b, f and ω in the IMU's frame (rpng/open_vins, VioManagerOptions.h and
    its configurations). OpenCV's FileStorage reads the block of the name imu0. Raises as
    `_file_an_imu`.
    """

    def text(imu: Imu, noise: dict[str, Any], said: list[str]) -> str:
        made = f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units."
        return chain(imu, noise, [made, *said])

    return _file_an_imu(calibration, "OpenVINS", text, ("gyro_g_sensitivity",))


def chain(imu: Imu, noise: dict[str, Any], said: list[str]) -> str:
    """kalibr_imu_chain.yaml of an IMU with the noise that `noise_of` gives and comments."""
    block = {
        "T_i_b": imu.from_board.tolist(),
        "time_offset": 0.0,
        "model": "kalibr",
        "Tw": imu.gyro.tolist(),
        "R_IMUtoGYRO": imu.gyro_turn.tolist(),
        "Ta": imu.accelerometer.tolist(),
        "R_IMUtoACC": np.eye(3).tolist(),
        "Tg": (imu.by_force @ imu.gyro_turn).tolist(),
    }
    read = "# OpenVINS reads the block imu0 and passes over T_i_b, time_offset and update_rate."
    text = dump({"imu0": {**noise, **block}}, indented=True)
    return "\n".join(["%YAML:1.0", *said, read, text])


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


def _file_an_imu(
    calibration: Calibration,
    program: str,
    text: Callable[[Imu, dict[str, Any], list[str]], str],
    kept: tuple[str, ...] = _KEPT,
) -> Made:
    """What a program that filters reads, which estimates biases by itself.

    text : of an IMU's file, from its noise and what is said in comments
    kept : effects that it has a place for
    Raises as `imus_of`, and UsageError where nothing is known of one of its noises.
    """
    lost, loss, rate_loss = lost_of(calibration, kept)
    lost = (f"the biases: {program} estimates them in every recording", *lost)
    files = {}
    for imu in imus_of(calibration, program):
        noise, said = noise_of(imu, program)
        files[imu.name] = text(imu, noise, [*said, *(f"# Not in it: {one}." for one in lost)])
    return Made(
        "---\n".join(files.values()), lost, loss, rate_loss, files if len(files) > 1 else {}
    )


KALIBR = Export("kalibr", "imu_kalibr.yaml", kalibr)
OPENVINS = Export("openvins", "kalibr_imu_chain.yaml", openvins)
