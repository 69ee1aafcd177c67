"""PX4's accelerometer parameters, as QGroundControl loads them."""

from __future__ import annotations

import math

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.flight.parameters import Flight, flight_of
from imucalib.exports.per_axis import heading
from imucalib.recording.identity import NAMELESS
from imucalib.recording.onboard import Onboard, in_px4

#: MAV_PARAM_TYPE_REAL32 and _INT32.
_FLOAT, _INT = 9, 6


def px4(calibration: Calibration, filename: str) -> Made:
    """CAL_ACC0_?OFF (m/s²) and CAL_ACC0_?SCALE, of a log's second IMU CAL_ACC1_...: corrected =
    (raw - offset) scale, then the board's rotation (PX4-Autopilot,
    src/lib/sensor_calibration/Accelerometer.hpp; limits of the scale:
    src/modules/sensors/module.yaml). Where a bias follows the temperature, TC_A0 and TC_G0 take
    Σ_k X_k (T - TREF)^k off before, T within TMIN and TMAX (src/modules/temperature_compensation,
    calc_thermal_offsets_3D). Raises as `flight_of`.
    """
    sensor = calibration.sensor or NAMELESS
    own, rates = ((one or Onboard()).slot for one in (sensor.onboard, sensor.onboard_rate))
    acc, gyro = in_px4("ACC", own), in_px4("GYRO", rates)
    names = (f"{acc}_ID", f"{gyro}_ID")
    flight = flight_of(calibration, "PX4", (0.1, 3.0), math.inf, names, "as sensor_accel logs them")
    lines = [
        *heading(calibration, filename),
        f"# For readings {flight.raw}: x forward, y right, z down,",
        "# z about -9.8 m/s2 at rest and level. Restart after loading.",
        *(f"# Not in it: {text}." for text in flight.lost),
        "#",
        "# Vehicle-Id Component-Id Name Value Type",
        *(f"1\t1\t{name}\t{number}\t{_INT}" for name, number in flight.ids.items()),
    ]
    for k, axis in enumerate("XYZ"):
        for name, value in (("OFF", flight.offset[k]), ("SCALE", flight.scale[k])):
            lines.append(f"1\t1\t{acc}_{axis}{name}\t{value:.9g}\t{_FLOAT}")
    if flight.rate is not None:  # corrected = rotation (raw - offset), rad/s (Gyroscope.hpp)
        lines += [
            f"1\t1\t{gyro}_{axis}OFF\t{value:.9g}\t{_FLOAT}"
            for axis, value in zip("XYZ", flight.rate, strict=True)
        ]
    lines += [*_thermal(flight, "A", own, names[0]), *_thermal(flight, "G", rates, names[1])]
    return Made("\n".join([*lines, ""]), flight.lost, flight.loss)


def _thermal(flight: Flight, sensor: str, number: int, own: str) -> list[str]:
    """Of the accelerometer "A" or the gyroscope "G"; nothing where no law is known."""
    thermal = flight.thermal
    powers = None
    if thermal is not None:
        powers = thermal.force if sensor == "A" else thermal.rate
    if thermal is None or powers is None:
        return []
    name = f"TC_{sensor}{number}"
    found = {"TREF": thermal.middle, "TMIN": thermal.low, "TMAX": thermal.high}
    for power, row in enumerate((np.zeros(3), *powers)):
        found |= {f"X{power}_{axis}": float(value) for axis, value in enumerate(row)}
    numbers = [f"1\t1\t{name}_{key}\t{value:.9g}\t{_FLOAT}" for key, value in found.items()]
    ids = [f"1\t1\t{name}_ID\t{flight.ids[own]}\t{_INT}"] if own in flight.ids else []
    return [f"1\t1\tTC_{sensor}_ENABLE\t1\t{_INT}", *ids, *numbers]


EXPORT = Export("px4", "imucal_px4.params", px4)
