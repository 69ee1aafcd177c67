"""Noise of sensors at rest for other programs, in the numbers that the code of each takes.

With a density N (unit/√Hz), a walk K (unit/s/√Hz) and a rate f (Hz), the sd of a sample is N √f and
a bias goes on by K/√f from one sample to the next.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from imucalib.errors import UsageError
from imucalib.exports.filters import chain
from imucalib.exports.imus import Imu, noise_of
from imucalib.inspection.noise import SensorNoise, noise_blocks
from imucalib.question import paste
from imucalib.recording.yaml_text import dump

#: HKUST-Aerial-Robotics/VINS-Mono, integration_base.h: a step of dt adds acc_n dt to the velocity
#: and acc_w dt to the bias, so acc_n is N √f and acc_w is K √f.
_VINS = {
    "acc_n": "accelerometer_noise_density",
    "gyr_n": "gyroscope_noise_density",
    "acc_w": "accelerometer_random_walk",
    "gyr_w": "gyroscope_random_walk",
}
#: UZ-SLAMLab/ORB_SLAM3, Tracking.cc: densities times √f, walks over √f, f being IMU.Frequency.
_ORBSLAM3 = {
    "IMU.NoiseGyro": "gyroscope_noise_density",
    "IMU.NoiseAcc": "accelerometer_noise_density",
    "IMU.GyroWalk": "gyroscope_random_walk",
    "IMU.AccWalk": "accelerometer_random_walk",
    "IMU.Frequency": "update_rate",
}


@dataclass(frozen=True)
class NoiseForm:
    """file : its usual name; text : from the noise of all sensors, and comments that it begins
    with; reads : what the other program takes, in words"""

    file: str
    text: Callable[[Sequence[SensorNoise], list[str]], str]
    reads: str


def noise_text(noise: Sequence[SensorNoise], form: str, source: str) -> str:
    """A form's file. source : the recording's name

    Raises UsageError where the form holds one IMU and these are several, or needs a sensor that
    the recording lacks.
    """
    made = NOISE_FORMS[form]
    said = [
        f"# Noise at rest of {source}, by imucal; of each sensor's noisiest axis (imu_utils: the "
        "mean of the axes).",
        f"# {made.reads}",
    ]
    return made.text(noise, said)


def _kalibr(noise: Sequence[SensorNoise], said: list[str]) -> str:
    """ethz-asl/kalibr, ImuParameters in ConfigReader.py: rostopic, update_rate and four positive
    numbers; other keys are passed over. One sensor's keys stand alone, more by name."""
    blocks = noise_blocks(noise)
    said = said + [
        f"# {name}: upper limits (95 %), the rests do not show more: {', '.join(limits)}"
        for name, block in blocks.items()
        if (limits := block.get("upper_limits"))
    ]
    return "\n".join([*said, dump(next(iter(blocks.values())) if len(blocks) == 1 else blocks)])


def _openvins(noise: Sequence[SensorNoise], said: list[str]) -> str:
    """rpng/open_vins, kalibr_imu_chain.yaml, with the intrinsics of a perfect IMU."""
    imu, numbers, limits = _only(noise, "OpenVINS")
    return chain(imu, numbers, [*said, *limits])


def _opencv(
    noise: Sequence[SensorNoise], said: list[str], program: str, keys: Mapping[str, str], by: float
) -> str:
    """A file as OpenCV reads it. keys : of the program -> of `noise_of`; by : the power of the rate
    that numbers are times"""
    _, numbers, limits = _only(noise, program)
    factor = float(numbers["update_rate"] ** by)
    lines = [f"{name}: {float(f'{factor * numbers[key]:.6g}')!r}" for name, key in keys.items()]
    return "\n".join(["%YAML:1.0", *said, *limits, *lines, ""])


def _ros(noise: Sequence[SensorNoise], said: list[str]) -> str:
    """sensor_msgs/Imu: row-major covariances of a message's values, of each axis its own; -1 first
    says that there is no orientation."""
    blocks: dict[str, dict[str, Any]] = {}
    fields = {"acceleration": "linear_acceleration", "angular_rate": "angular_velocity"}
    for sensor in noise:
        square = [sensor.rate * (a.white.value or a.white.below) ** 2 for a in sensor.axes]
        block = blocks.setdefault(sensor.triad, {"orientation_covariance": [-1.0, *[0.0] * 8]})
        matrix = np.diag([float(f"{value:.6g}") for value in square]).ravel()
        block[f"{fields[sensor.quantity]}_covariance"] = matrix.tolist()
    return "\n".join([*said, dump(next(iter(blocks.values())) if len(blocks) == 1 else blocks)])


def _allan_csv(noise: Sequence[SensorNoise], said: list[str]) -> str:
    """A row an averaging time of every axis, in SI."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    header = "sensor,quantity,axis,unit,tau_s,deviation,low,high,fit,fit_low,fit_high,holds"
    rows.writerow(header.split(","))
    for sensor in noise:
        for letter, axis in zip("xyz", sensor.axes, strict=False):
            curve, words = axis.curve, (sensor.triad, sensor.quantity, letter, sensor.unit)
            columns = (curve.tau, curve.deviation, *curve.interval(), *axis.fit)
            for values, holds in zip(zip(*columns, strict=True), axis.holds, strict=True):
                rows.writerow([*words, *(f"{value:.9g}" for value in values), int(holds)])
    return text.getvalue()


def _only(noise: Sequence[SensorNoise], program: str) -> tuple[Imu, dict[str, Any], list[str]]:
    """The one IMU, and what `noise_of` gives of it."""
    blocks = noise_blocks(noise)
    if len(blocks) != 1:
        raise UsageError(
            f"{program} reads one IMU, the recording has {', '.join(blocks)}",
            remedy=f"name one: {paste('--sensor', next(iter(blocks)))}",
        )
    name, block = next(iter(blocks.items()))
    imu = Imu(name, block, topic=block["rostopic"])
    return imu, *noise_of(imu, program, "name columns of both (--acc, --gyro), or use --to ros")


#: By name on the command line.
NOISE_FORMS = {
    "kalibr": NoiseForm(
        "imu.yaml",
        _kalibr,
        "Kalibr reads densities, m/s2/sqrt(Hz) and rad/s/sqrt(Hz), and walks, m/s3/sqrt(Hz) and "
        "rad/s2/sqrt(Hz).",
    ),
    "openvins": NoiseForm(
        "kalibr_imu_chain.yaml",
        _openvins,
        "OpenVINS reads densities and walks in the units of Kalibr; the intrinsics here are those "
        "of a perfect IMU.",
    ),
    "vins": NoiseForm(
        "vins.yaml",
        partial(_opencv, program="VINS", keys=_VINS, by=0.5),
        "VINS-Mono and VINS-Fusion read the sd of a sample, m/s2 and rad/s, and walks times the "
        "root of the rate: for the rate of this recording.",
    ),
    "orbslam3": NoiseForm(
        "orbslam3.yaml",
        partial(_opencv, program="ORB-SLAM3", keys=_ORBSLAM3, by=0.0),
        "ORB-SLAM3 reads densities and walks in the units of Kalibr, and makes them of a sample "
        "with IMU.Frequency.",
    ),
    "ros": NoiseForm(
        "imu_covariances.yaml",
        _ros,
        "sensor_msgs/Imu holds variances of a sample, (m/s2)^2 and (rad/s)^2, row by row: for the "
        "rate of this recording.",
    ),
    "allan-csv": NoiseForm(
        "allan.csv", _allan_csv, "Overlapping Allan deviations with 95 % intervals, in SI."
    ),
}
