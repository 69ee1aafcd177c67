"""OpenVINS' kalibr_imu_chain.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made, of_each
from imucalib.exports.imus import Imu, imus_of, losses_of, lost_of, lost_to_filters, noise_lines
from imucalib.exports.kalibr import rows
from imucalib.recording.yaml_text import dump


def openvins(calibration: Calibration, filename: str) -> Made:
    """A file an IMU, model kalibr: reading = Ta R_IMUtoACC f + b, rate reading =
    Tw R_IMUtoGYRO ω + Tg f + b, f and ω in the IMU's frame (rpng/open_vins, VioManagerOptions.h and
    its configurations). OpenCV's FileStorage reads the block of the name imu0. Raises as `imus_of`
    and `noise_lines`.
    """
    imus = imus_of(calibration, "OpenVINS")
    kept = ("gyro_g_sensitivity",)
    lost = (*lost_to_filters(calibration, "OpenVINS"), *lost_of(calibration, kept))
    files = {}
    for imu in imus:
        noise, said = noise_lines(imu, "OpenVINS")
        lines = [
            "%YAML:1.0",
            f"# {imu.name} by imucal, from {filename}, status {calibration.status}. SI units.",
            "# OpenVINS reads the block imu0 and passes over T_i_b, time_offset and update_rate.",
            *said,
            *(f"# Not in it: {text}." for text in lost),
        ]
        content = dump({"imu0": {**noise, **_block(imu)}}, indented=True)
        files[imu.name] = "\n".join([*lines, content])
    return of_each(files, lost, losses_of(calibration, kept))


def _block(imu: Imu) -> dict[str, Any]:
    return {
        "T_i_b": rows(imu.from_board),
        "time_offset": 0.0,
        "model": "kalibr",
        "Tw": rows(imu.gyro),
        "R_IMUtoGYRO": rows(imu.gyro_turn),
        "Ta": rows(imu.accelerometer),
        "R_IMUtoACC": rows(np.eye(3)),
        "Tg": rows(imu.by_force @ imu.gyro_turn),
    }


EXPORT = Export("openvins", "kalibr_imu_chain.yaml", openvins)
