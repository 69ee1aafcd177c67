"""Accelerometers as flight controllers hold them, a scale and an offset an axis: composed with what
was in force while the log was written, against the id of a sensor, and a polynomial of what a bias
adds over temperature.

ArduPilot's parameters are as its ground stations load them, PX4's as QGroundControl does.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.core.effect import Context
from imucalib.errors import UsageError
from imucalib.exports import Export, Made
from imucalib.exports.imus import lost_rates
from imucalib.exports.nearest import demand_one, heading, lost_per_axis, nearest_row
from imucalib.recording.identity import NAMELESS
from imucalib.recording.onboard import Onboard, in_ardupilot, in_px4
from imucalib.units import STANDARD_GRAVITY

#: Forms of flight controllers, which hold parameters against the id of a sensor.
FLIGHT = ("px4", "ardupilot")
_IDS = "device_ids"
_AXES = "x forward, y right, z down, z about -9.8 m/s2 at rest and level. Restart after loading."
#: Powers that the controllers hold, and temperatures at which a law is read.
_POWERS, _TEMPERATURES = 3, 25
#: °C about which the firmware's polynomial stands.
_REFERENCE = 35.0
#: MAV_PARAM_TYPE_REAL32 and _INT32.
_FLOAT, _INT = 9, 6


def state_ids(calibration: Calibration, ids: tuple[int, ...]) -> Calibration:
    """A calibration whose accelerometer, and gyroscope, has the id that a controller gives it."""
    return replace(calibration, facts={**calibration.facts, _IDS: list(ids)})


@dataclass(frozen=True)
class Thermal:
    """What a reading without force and rate has beyond that at `middle`, Σ_k c_k (T - middle)^k for
    T from `low` to `high`, °C.

    force : (3, 3) m/s² per °C^k, powers 1 to 3 by axis; rate : the same in rad/s, or None
    """

    low: float
    high: float
    middle: float
    force: Array
    rate: Array | None

    def before(self, force: Iterable[float], rate: Iterable[float]) -> Thermal:
        """The same of readings that are multiplied by these, (3,) or (1,), afterwards."""
        powers = None if self.rate is None else self.rate / np.array([*rate])
        return replace(self, force=self.force / np.array([*force]), rate=powers)

    def about(self, reference: float) -> tuple[Array, Array | None]:
        """The same powers (3, 3) about another temperature, without what is constant: differences
        of two temperatures are the same."""
        shift = self.middle - reference
        # (x - s)^k in powers of x, both from 1 on.
        turn = np.array(
            [
                [1.0, -2.0 * shift, 3.0 * shift**2],
                [0.0, 1.0, -3.0 * shift],
                [0.0, 0.0, 1.0],
            ]
        )
        return turn @ self.force, None if self.rate is None else turn @ self.rate


@dataclass(frozen=True)
class Flight:
    """corrected = scale (raw - thermal - offset) of a flight controller, composed with what was in
    force while its log was written.

    offset, scale : (3,), offset in m/s²; rate : (3,) rad/s, the gyroscope's, or None; both in the
    middle of the temperatures; thermal : what is beyond these there, or None
    ids : parameter -> id, of those that are known
    raw : of which readings these are, in words
    lost : in words; loss : mg, of the vector
    """

    offset: Array
    scale: Array
    rate: Array | None
    thermal: Thermal | None
    ids: dict[str, int]
    raw: str
    lost: tuple[str, ...]
    loss: float


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
        *heading(calibration, filename, flight.lost, f"For readings {flight.raw}:", _AXES),
        *(f"{name},{number}" for name, number in flight.ids.items()),
    ]
    for name, values in ((f"{acc}OFFS", flight.offset), (f"{acc}SCAL", flight.scale)):
        lines += [f"{name}_{axis},{values[k]:.9g}" for k, axis in enumerate("XYZ")]
    if flight.rate is not None:  # rad/s, taken off (_rotate_and_correct_gyro)
        lines += [f"{gyro}OFFS_{axis},{flight.rate[k]:.9g}" for k, axis in enumerate("XYZ")]
    lines += _ardupilot_thermal(flight, number + 1)
    return Made("\n".join([*lines, ""]), flight.lost, flight.loss)


def _ardupilot_thermal(flight: Flight, number: int) -> list[str]:
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
        *heading(calibration, filename, flight.lost, f"For readings {flight.raw}:", _AXES),
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
    lines += [
        *_px4_thermal(flight, "A", own, names[0]),
        *_px4_thermal(flight, "G", rates, names[1]),
    ]
    return Made("\n".join([*lines, ""]), flight.lost, flight.loss)


def _px4_thermal(flight: Flight, sensor: str, number: int, own: str) -> list[str]:
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


def flight_of(
    calibration: Calibration,
    program: str,
    scales: tuple[float, float],
    offset: float,
    names: tuple[str, str],
    raw: str,
) -> Flight:
    """The nearest, for a program that takes scales within `scales` and offsets (m/s²) up to
    `offset`, and holds them against the ids in the parameters `names`, accelerometer first.

    raw : in words, the readings that it is for where the log does not say what was done to them
    Raises UsageError for an array and for what it does not take.
    """
    demand_one(calibration, program)
    sensor, thermal = calibration.sensor or NAMELESS, thermal_of(calibration)
    boards = (sensor.onboard or Onboard(), sensor.onboard_rate or Onboard())
    row = nearest_row(calibration, slope=thermal is not None)
    found, scale = boards[0].compose(-STANDARD_GRAVITY * row.offset, row.scale)
    _demand_taken(program, scale, scales, found, offset)
    lost, gyro = lost_per_axis(calibration, row), gyroscope_of(calibration)
    needed = names if gyro else names[:1]
    stated = calibration.facts.get(_IDS) or [one.device for one in boards]
    ids = {name: one for name, one in zip(needed, stated, strict=False) if one}
    lost += tuple(
        f"{name}: it must name this sensor, or {program} passes over these (--device-id)"
        for name in needed
        if name not in ids
    )
    if gyro is not None:
        off = np.abs(gyro.gain - np.eye(3)).max()
        more = f"the gyroscope's gains, up to {100.0 * off:.1f} % of a rate"
        carried = ("gyro_temperature_bias",) if thermal is not None else ()
        lost = (*lost, more, *lost_rates(calibration, carried))
    rate = None if gyro is None else gyro.bias
    if gyro is not None and thermal is not None:
        still = np.zeros((1, 3))
        rate = gyro.bias + gyro.evaluate_laws(still, still, np.array([thermal.middle]))[0]
    if rate is not None:
        rate, _ = boards[1].compose(rate, np.ones(3))
    boards[0].demand_law(own=thermal is not None)
    if gyro is not None:
        boards[1].demand_law(own=thermal is not None and thermal.rate is not None)
    known = boards[0].scale
    return Flight(
        offset=found,
        scale=scale,
        rate=rate,
        thermal=thermal and thermal.before(*(one.scale or (1.0,) for one in boards)),
        ids=ids,
        raw="composed with the parameters of its log" if known else raw,
        lost=lost,
        loss=row.vector,
    )


def _demand_taken(
    program: str, scale: Array, scales: tuple[float, float], offset: Array, most: float
) -> None:
    """Raise UsageError for scales (3,) and offsets (3,) m/s² that a program does not take."""
    if not (scales[0] <= scale.min() and scale.max() <= scales[1]):
        raise UsageError(
            f"{program} takes scales of {scales[0]:g} to {scales[1]:g}, this accelerometer needs "
            f"{scale.min():.3f} to {scale.max():.3f}",
            remedy="check the unit of the readings",
        )
    if np.abs(offset).max() > most:
        raise UsageError(
            f"{program} takes offsets up to {most:g} m/s², this accelerometer needs "
            f"{np.abs(offset).max():.2f}",
            remedy="check the unit of the readings",
        )


def thermal_of(calibration: Calibration) -> Thermal | None:
    """The polynomials nearest to a calibration's laws, or None where nothing follows the
    temperature."""
    low, high = calibration.valid.get("temperature", (0.0, 0.0))
    model, theta = calibration.model()
    gyro = gyroscope_of(calibration)
    warm = np.linspace(low, high, _TEMPERATURES)
    if high <= low:
        return None
    known = calibration.context(warm.size).covariates
    context = Context(warm.size, {**known, "temperature": warm})
    nothing = np.zeros((warm.size, 1, 3))
    read = model.predict(theta, nothing, context).reading[:, 0]
    added = (
        np.zeros((0, 3)) if gyro is None else gyro.evaluate_laws(nothing[:, 0], nothing[:, 0], warm)
    )
    if max(float(np.ptp(one, axis=0).max()) for one in (read, added) if len(one)) <= 0.0:
        return None
    middle = 0.5 * (low + high)
    rate = None if gyro is None else _powers(warm - middle, added)
    return Thermal(low, high, middle, _powers(warm - middle, read), rate)


def _powers(warm: Array, read: Array) -> Array:
    """(3, 3) coefficients of powers of warm (n,) of numbers (n, 3)."""
    columns = np.vander(warm, _POWERS + 1, increasing=True)
    unit = np.abs(columns).max(axis=0)
    found = np.linalg.lstsq(columns / unit, read, rcond=None)[0] / unit[:, None]
    return np.asarray(found[1:])


ARDUPILOT = Export("ardupilot", "imucal_ardupilot.param", ardupilot)
PX4 = Export("px4", "imucal_px4.params", px4)
