"""What a difference between calibrations means: the corrected force in every attitude.

The first calibration's reading of gravity, f(u) = g u, is corrected by the other. Its size may be
compared always, its direction where both mean the same frame. Standard deviations carry the full
covariances of both, S C Sᵀ with S the slope of the corrected force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.comparison.sensor import CalibratedSensor
from imucalib.core.references import tangents
from imucalib.core.sphere import even_directions
from imucalib.units import DEG, MG

_ATTITUDES = 400


@dataclass(frozen=True)
class Seen:
    """m calibrations in n attitudes, against the first. attitude : (n, 3) unit vectors
    size : (m, n) mg, of |f|; size_sd : (m, n) mg, of each one's own
    turn : (m, n, 2) deg, along two tangents; turn_covariance : (m, n, 2, 2) of each one's own
    """

    attitude: Array
    size: Array
    size_sd: Array
    turn: Array
    turn_covariance: Array


@dataclass(frozen=True)
class Worst:
    """The largest difference of a pair. pair : numbers of the calibrations; value, sd : in `unit`;
    attitude : (3,) unit vector of the specific force"""

    pair: tuple[int, int]
    value: float
    sd: float
    unit: str
    attitude: Array


def seen(sensors: Sequence[CalibratedSensor], gravity: float) -> Seen:
    """gravity : m/s²"""
    attitude = even_directions(_ATTITUDES)
    across = tangents(attitude)
    truth = gravity * attitude
    reading = sensors[0].reading(truth)
    size, size_sd, turn, spread = [], [], [], []
    for sensor in sensors:
        force, slope = sensor.force(reading), sensor.slope(truth)
        own = np.einsum("nip,pq,njq->nij", slope, sensor.covariance, slope)
        size.append((np.linalg.norm(force, axis=1) - gravity) / MG)
        size_sd.append(np.sqrt(np.einsum("ni,nij,nj->n", attitude, own, attitude)) / MG)
        turn.append(np.einsum("ni,nik->nk", force, across) / gravity / DEG)
        spread.append(np.einsum("nik,nij,njl->nkl", across, own, across) / (gravity * DEG) ** 2)
    return Seen(attitude, np.array(size), np.array(size_sd), np.array(turn), np.array(spread))


def worst_size(found: Seen) -> Worst:
    """Of |f|, over all pairs and attitudes."""

    def one(i: int, j: int) -> tuple[float, int]:
        away = np.abs(found.size[j] - found.size[i])
        return float(away.max()), int(away.argmax())

    (value, at), pair = max((one(i, j), (i, j)) for i, j in pairs_of(len(found.size)))
    sd = float(np.hypot(found.size_sd[pair[0], at], found.size_sd[pair[1], at]))
    return Worst(pair, value, sd, "mg", found.attitude[at])


def worst_turn(found: Seen) -> Worst:
    """Of the direction, over all pairs and attitudes; sd along the difference."""

    def one(i: int, j: int) -> tuple[float, int]:
        away = np.linalg.norm(found.turn[j] - found.turn[i], axis=1)
        return float(away.max()), int(away.argmax())

    (value, at), pair = max((one(i, j), (i, j)) for i, j in pairs_of(len(found.turn)))
    along = (found.turn[pair[1], at] - found.turn[pair[0], at]) / max(value, 1e-300)
    both = found.turn_covariance[pair[0], at] + found.turn_covariance[pair[1], at]
    return Worst(pair, value, float(np.sqrt(along @ both @ along)), "deg", found.attitude[at])


def largest_sd(found: Seen) -> tuple[float, float]:
    """The largest stated sd of any calibration in any attitude: of |f| in mg, of the direction in
    deg."""
    turn = np.linalg.eigvalsh(found.turn_covariance)[..., -1]
    return float(found.size_sd.max()), float(np.sqrt(turn.max()))


def pairs_of(m: int) -> list[tuple[int, int]]:
    """All pairs of m things."""
    return [(i, j) for i in range(m) for j in range(i + 1, m)]
