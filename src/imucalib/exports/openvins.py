"""OpenVINS' kalibr_imu_chain.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import Imu, file_an_imu
from imucalib.recording.yaml_text import dump


def openvins(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model kalibr: reading = Ta R_IMUtoACC f + b, rate reading =
    Tw R_IMUtoGYRO ω + Tg f + b, f and ω in the IMU's frame (rpng/open_vins, VioManagerOptions.h and
    its configurations). OpenCV's FileStorage reads the block of the name imu0. Raises as
    `file_an_imu`.
    """

    def text(imu: Imu, noise: dict[str, Any], said: list[str]) -> str:
        made = f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units."
        return chain(imu, noise, [made, *said])

    return file_an_imu(calibration, "OpenVINS", text, ("gyro_g_sensitivity",))


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


EXPORT = Export("openvins", "kalibr_imu_chain.yaml", openvins)
