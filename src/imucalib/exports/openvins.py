"""OpenVINS' kalibr_imu_chain.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.imus import Imu, force_lost, imus_of, lost_noise, lost_of, lost_to_filters
from imucalib.exports.kalibr import rows
from imucalib.recording.yaml_text import dump


def openvins(calibration: Calibration, filename: str) -> Made:
    """A block an IMU, model kalibr: reading = Ta R_IMUtoACC f + b, rate reading =
    Tw R_IMUtoGYRO ω + Tg f + b, f and ω in the IMU's frame (rpng/open_vins, ImuConfig of
    ov_msckf and its configurations). Raises as `imus_of`.
    """
    imus = imus_of(calibration, "OpenVINS")
    kept = ("gyro_g_sensitivity",)
    lost = (
        *lost_to_filters(calibration, "OpenVINS"),
        *lost_of(calibration, kept),
        *lost_noise(imus),
    )
    lines = [
        "%YAML:1.0",
        f"# IMUs of an array by imucal, from {filename}, status {calibration.status}.",
        "# OpenVINS takes the block of the name imu0.",
        *(f"# Not in it: {text}." for text in lost),
    ]
    content = {imu.name: _block(imu) for imu in imus}
    return Made("\n".join([*lines, dump(content)]), lost, force_lost(calibration, kept))


def _block(imu: Imu) -> dict[str, Any]:
    return {
        "T_i_b": rows(imu.from_board),
        **{key: value for key, value in imu.noise.items() if key != "rostopic"},
        "rostopic": f"/{imu.name}/imu",
        "time_offset": 0.0,
        "model": "kalibr",
        "Tw": rows(imu.gyro),
        "R_IMUtoGYRO": rows(imu.gyro_turn),
        "Ta": rows(imu.accelerometer),
        "R_IMUtoACC": rows(np.eye(3)),
        "Tg": rows(imu.by_force @ imu.gyro_turn),
    }


EXPORT = Export("openvins", "kalibr_imu_chain.yaml", openvins)
