"""The largest differences, in what a user reads: mg, deg, mm, deg/s."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.limits import Limits
from imucalib.calibration.comparison.attitudes import (
    Seen,
    Worst,
    largest_sd,
    pairs_of,
    worst_size,
    worst_turn,
)
from imucalib.calibration.comparison.basis import Basis
from imucalib.units import DEG

#: Stated standard deviations that a difference may reach where no limit is given.
SIGNIFICANT = 2.0


@dataclass(frozen=True)
class Meaning:
    """The largest difference of one kind, and the size that matters. sensor : IMU of an array"""

    worst: Worst
    limit: float
    sensor: str = ""

    @property
    def beyond(self) -> bool:
        return self.worst.value > self.limit


def meanings_of(found: Mapping[str, Seen], limits: Limits, *, turns: bool) -> tuple[Meaning, ...]:
    """Force, and where it can be compared direction, of the sensor where it is largest."""
    sds = [largest_sd(one) for one in found.values()]
    force = limits.force
    direction = limits.direction
    if limits == Limits():
        force, direction = (SIGNIFICANT * max(column) for column in zip(*sds, strict=True))
    made = []
    for limit, worst in ((force, worst_size), (direction if turns else None, worst_turn)):
        if limit is not None:
            pairs = [(worst(one), name) for name, one in found.items()]
            largest, name = max(pairs, key=lambda pair: pair[0].value)
            made.append(Meaning(largest, limit, name))
    return tuple(made)


def array_meanings(
    calibrations: Sequence[Calibration], basis: Basis, limits: Limits
) -> tuple[tuple[Meaning, ...], tuple[str, ...]]:
    """Positions in mm and biases of gyroscopes in deg/s, of which the files state no sd."""
    limit = limits.position
    if limits == Limits():
        limit = SIGNIFICANT * float(np.sqrt(np.einsum("kii->ki", basis.covariance).max()))
    made = () if limit is None else (_places(calibrations, basis, limit),)
    rates = np.array([[t.gyro_bias / DEG for t in c.triads] for c in calibrations])
    away, pair = max(
        (float(np.abs(rates[j] - rates[i]).max()), (i, j)) for i, j in pairs_of(len(rates))
    )
    k, axis = divmod(int(np.abs(rates[pair[1]] - rates[pair[0]]).argmax()), 3)
    name = calibrations[0].triads[k].name
    said = (
        f"the gyroscopes' biases differ by {away:.2g} deg/s at most ({name}, {'xyz'[axis]}); the "
        "files state no uncertainty of these, so they are told and not tested"
    )
    if limits.rate is not None:
        worst = Worst(pair, away, math.nan, "deg/s", np.eye(3)[axis])
        made = (*made, Meaning(worst, limits.rate, name))
    return made, (said,)


def _places(calibrations: Sequence[Calibration], basis: Basis, limit: float) -> Meaning:
    """The IMU whose position differs most."""
    places = basis.value.reshape(len(calibrations), -1, 3)
    value, pair, k = max(
        (float(np.linalg.norm(places[j, k] - places[i, k])), (i, j), k)
        for i, j in pairs_of(len(places))
        for k in range(places.shape[1])
    )
    own = basis.covariance[list(pair), 3 * k : 3 * k + 3, 3 * k : 3 * k + 3].sum(axis=0)
    along = (places[pair[1], k] - places[pair[0], k]) / max(value, 1e-300)
    sd = float(np.sqrt(along @ own @ along))
    name = calibrations[0].triads[k + 1].name
    return Meaning(Worst(pair, value, sd, "mm", along), limit, name)
