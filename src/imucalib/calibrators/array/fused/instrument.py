"""A calibrated array as an instrument: what its file says, ready for the readings of a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.triads import Triad
from imucalib.calibrators.array.fused.beyond import Beyond, beyond_linear
from imucalib.calibrators.array.fused.doubt import Doubt, doubt_of
from imucalib.errors import UnreadableInput, UsageError
from imucalib.units import DEG, STANDARD_GRAVITY

_AT_RANGE = 0.998  # share of the range from which a reading counts as clipped


@dataclass(frozen=True)
class Biases:
    """What corrected readings still hold at rest, in board axes.

    force : (K, 3) m/s²; at : (m,) s; rate : (m, K, 3) rad/s at these times, straight between them
    """

    force: Array
    at: Array
    rate: Array

    def rate_at(self, t: Array) -> Array:
        """(T, K, 3) rad/s at times t (T,) s; beyond the ends as at the ends."""
        if len(self.at) == 1:
            return np.broadcast_to(self.rate, (len(t), *self.rate.shape[1:]))
        after = np.clip(np.searchsorted(self.at, t), 1, len(self.at) - 1)
        share = (t - self.at[after - 1]) / (self.at[after] - self.at[after - 1])
        share = np.clip(share, 0.0, 1.0)[:, None, None]
        return np.asarray((1.0 - share) * self.rate[after - 1] + share * self.rate[after])


def no_biases(count: int) -> Biases:
    """The calibration's own hold."""
    return Biases(np.zeros((count, 3)), np.zeros(1), np.zeros((1, count, 3)))


@dataclass(frozen=True)
class Instrument:
    """K IMUs whose readings become one motion.

    r : (K, 3) m, positions about the point whose specific force is wanted, which lies at `at` (m)
        in the frame of the board's drawing
    axes, gyro_axes : (K, 3, 3), in its rows what each axis of a sensor senses, in board axes
    beyond : what found effects add beyond the linear correction
    biases : what the log's own rests show beside the calibration's
    accelerometer_range, gyroscope_range : m/s² and rad/s; inf where not known
    doubt : what the calibration leaves open, None where its file does not say
    partner : of a log that was looked through, its sensors -> indices of the triads
    """

    triads: tuple[Triad, ...]
    r: Array
    at: Array
    beyond: Beyond
    biases: Biases
    accelerometer_range: float
    gyroscope_range: float
    doubt: Doubt | None = None
    partner: Mapping[str, int] | None = None

    @property
    def imus(self) -> tuple[str, ...]:
        return tuple(t.name for t in self.triads)

    @property
    def axes(self) -> Array:
        return np.array([t.rotation.T @ t.gain for t in self.triads])

    @property
    def gyro_axes(self) -> Array:
        return np.array([t.rotation.T @ t.gyro_gain for t in self.triads])

    def corrected(self, t: Array, acceleration: Array, rate: Array) -> tuple[Array, Array]:
        """Force and rate (T, K, 3) in board axes at times t (T,) s, of readings (T, K, 3) in the
        sensors' own; of a missing one, as if it were zero."""
        acceleration, rate = np.nan_to_num(acceleration), np.nan_to_num(rate)
        force = np.stack([x.force(acceleration[:, k]) for k, x in enumerate(self.triads)], axis=1)
        turned = np.stack([x.rate(rate[:, k]) for k, x in enumerate(self.triads)], axis=1)
        return force - self.biases.force, turned - self.biases.rate_at(t)

    def clipped(self, acceleration: Array, rate: Array) -> tuple[Flags, Flags]:
        """(T, K, 3) which readings are at the end of their range."""
        return (
            np.asarray(np.abs(acceleration) >= _AT_RANGE * self.accelerometer_range),
            np.asarray(np.abs(rate) >= _AT_RANGE * self.gyroscope_range),
        )


def instrument_of(calibration: Calibration, at: Array | None = None) -> Instrument:
    """The instrument of an array's calibration.

    at : (3,) m in the frame of the board's drawing, the point whose specific force is wanted; by
        default the middle of the IMUs, where it is known best
    Raises UsageError for a calibration that is not of an array, UnreadableInput for one whose
    positions do not fit its IMUs.
    """
    if not calibration.triads:
        raise UsageError(
            f"a calibration by {calibration.calibrator} is of one sensor, there is nothing to fuse",
            remedy="use the calibration of an array",
        )
    facts, triads = calibration.facts, calibration.triads
    try:
        rows = {str(row["imu"]): row["mean"] for row in facts["positions_mm"]}
        places = 1e-3 * np.array([rows[t.name] for t in triads], dtype=float).reshape(-1, 3)
        first = 1e-3 * np.array(facts.get("reference_mm", np.zeros(3)), dtype=float).reshape(3)
    except (KeyError, TypeError, ValueError) as error:
        raise UnreadableInput(f"the positions do not fit the IMUs: {error!r}") from None
    drawn = places + first
    point = drawn.mean(axis=0) if at is None else at
    ranges = facts.get("ranges", {})
    return Instrument(
        triads=triads,
        r=drawn - point,
        at=point,
        beyond=beyond_linear(calibration),
        biases=no_biases(len(triads)),
        accelerometer_range=_range(ranges, "accelerometer_g", STANDARD_GRAVITY),
        gyroscope_range=_range(ranges, "gyroscope_deg_per_s", DEG),
        doubt=doubt_of(calibration, places - places[0]),
    )


def _range(stated: Mapping[str, Any], name: str, unit: float) -> float:
    value = stated.get(name)
    return float("inf") if value is None else float(value) * unit
