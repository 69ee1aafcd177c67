"""ArduPilot's accelerometer parameters, as its ground stations load them."""

from __future__ import annotations

from imucalib.calibration.calibration import Calibration
from imucalib.exports import Export, Made
from imucalib.exports.flight.parameters import Flight, flight_of
from imucalib.exports.per_axis import heading
from imucalib.recording.identity import NAMELESS
from imucalib.recording.onboard import Onboard, in_ardupilot

#: °C about which the firmware's polynomial stands.
_REFERENCE = 35.0


def ardupilot(calibration: Calibration, filename: str) -> Made:
    """INS_ACCOFFS_? (m/s²) and INS_ACCSCAL_?: corrected = (raw - offset) scale, after the sensor's
    and before the board's rotation (ArduPilot, AP_InertialSensor_Backend,
    _rotate_and_correct_accel; limits: AP_InertialSensor_Params). Where a bias follows the
    temperature, INS_TCAL1 takes p(T) - p(CALTEMP) off before, p a cubic about 35 °C in millionths,
    T within TMIN and TMAX (AP_InertialSensor_tempcal, correct_sensor). Raises as `flight_of`.
    """
    number = ((calibration.sensor or NAMELESS).onboard or Onboard()).slot
    acc, gyro = in_ardupilot("ACC", number), in_ardupilot("GYR", number)
    raw = "with INS_ACCOFFS 0, INS_ACCSCAL 1 and before AHRS_ORIENTATION"
    names = (f"{acc}_ID", f"{gyro}_ID")
    flight = flight_of(calibration, "ArduPilot", (0.8, 1.2), 3.5, names, raw)
    lines = [
        *heading(calibration, filename),
        f"# For readings {flight.raw}:",
        "# x forward, y right, z down, z about -9.8 m/s2 at rest and level. Restart after loading.",
        *(f"# Not in it: {text}." for text in flight.lost),
        *(f"{name},{number}" for name, number in flight.ids.items()),
    ]
    for name, values in ((f"{acc}OFFS", flight.offset), (f"{acc}SCAL", flight.scale)):
        lines += [f"{name}_{axis},{values[k]:.9g}" for k, axis in enumerate("XYZ")]
    if flight.rate is not None:  # rad/s, taken off (_rotate_and_correct_gyro)
        lines += [f"{gyro}OFFS_{axis},{flight.rate[k]:.9g}" for k, axis in enumerate("XYZ")]
    lines += _thermal(flight, number + 1)
    return Made("\n".join([*lines, ""]), flight.lost, flight.loss)


def _thermal(flight: Flight, number: int) -> list[str]:
    """Of an IMU by its number, from 1; nothing where no law is known."""
    thermal = flight.thermal
    if thermal is None:
        return []
    force, rate = thermal.about(_REFERENCE)
    found = {
        f"INS_TCAL{number}_ENABLE": 1.0,
        f"INS_TCAL{number}_TMIN": thermal.low,
        f"INS_TCAL{number}_TMAX": thermal.high,
        f"INS_ACC{number}_CALTEMP": thermal.middle,
        f"INS_GYR{number}_CALTEMP": thermal.middle,
    }
    for name, powers in (("ACC", force), ("GYR", rate)):
        for power, row in enumerate([] if powers is None else powers, start=1):
            each = zip("XYZ", row, strict=True)
            found |= {f"INS_TCAL{number}_{name}{power}_{axis}": 1e6 * float(v) for axis, v in each}
    return [f"{name},{value:.9g}" for name, value in found.items()]


EXPORT = Export("ardupilot", "imucal_ardupilot.param", ardupilot)
