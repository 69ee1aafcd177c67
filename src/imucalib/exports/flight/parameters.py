"""A scale and an offset an axis as flight controllers hold them: composed with what was in force
while the log was written, against the id of a sensor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import gyroscope_of
from imucalib.errors import UsageError
from imucalib.exports.flight.thermal import Thermal, thermal_of
from imucalib.exports.imus import lost_rates
from imucalib.exports.per_axis import demand_one, lost_per_axis, nearest_row
from imucalib.recording.identity import NAMELESS
from imucalib.recording.onboard import Onboard
from imucalib.units import STANDARD_GRAVITY

#: Forms of flight controllers, which hold parameters against the id of a sensor.
FLIGHT = ("px4", "ardupilot")
_IDS = "device_ids"


def state_ids(calibration: Calibration, ids: tuple[int, ...]) -> Calibration:
    """A calibration whose accelerometer, and gyroscope, has the id that a controller gives it."""
    return replace(calibration, facts={**calibration.facts, _IDS: list(ids)})


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
