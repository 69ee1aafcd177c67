"""Where IMUs are, by linear algebra on their accelerometers: exchanged places, another unit.

a_k - mean = W(ω, dω/dt) (r_k - mean) with the gyros' rate and its differences: good to a millimetre
without any calibration, enough to tell one place of the drawing from another.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.core.effect import cross_matrix

_FEWEST = 60
_CLEARER = 4.0  # times that another order must lower the squared distance of those that move
_EXPLAINED = 0.3  # share of the differences that places must explain
_SIZE = 2.0  # factor between the sizes of board and drawing that is another unit of length
_RATES = 500.0  # and that from which it is one of the rates: the size goes with their square
_GRAVITY = 4.0, 20.0  # m/s² between which the force at rest must lie to be in its unit


@dataclass(frozen=True)
class Places:
    """seen : (K, 3) m by the motion, about their mean; place : (K,) of the drawing at which each
    IMU stands; size : of the array over the drawing's; inverted : whether all accelerometers read
    with the other sign"""

    seen: Array
    place: Index
    size: float
    inverted: bool

    @property
    def exchanged(self) -> Index:
        return np.flatnonzero(self.place != np.arange(len(self.place)))

    @property
    def other_unit(self) -> bool:
        factor = max(self.size, 1.0 / self.size)
        return _SIZE < factor < _RATES


def in_its_unit(still: Array) -> bool:
    """Whether readings (m, K, 3) m/s² at rest have about the size of gravity."""
    size = np.median(np.linalg.norm(still, axis=2), axis=0)
    return bool(np.all((size > _GRAVITY[0]) & (size < _GRAVITY[1])))


def places(
    t: Array, force: Array, rate: Array, usable: Flags, *, drawn: Array, mounted: Array
) -> Places | None:
    """Places of K IMUs; None where the motion does not show them.

    t : (n,) s; force : (n, K, 3) m/s² and rate : (n, 3) rad/s in board axes; usable : (n,) neither
    clipped nor slow; drawn : (K, 3) m; mounted : (K, 3, 3), package to board
    """
    seen = rough_places(t, force, rate, usable)
    return None if seen is None else _placed(seen, drawn - drawn.mean(axis=0), mounted)


def rough_places(t: Array, force: Array, rate: Array, usable: Flags) -> Array | None:
    """(K, 3) m about their mean, good to a millimetre; None where the motion does not show them."""
    step = float(np.median(np.diff(t)))
    regular = np.abs(t[2:] - t[:-2] - 2.0 * step) < 0.3 * step
    rows = 1 + np.flatnonzero(usable[1:-1] & usable[:-2] & usable[2:] & regular)
    if len(rows) < _FEWEST:
        return None
    spin = (rate[rows + 1] - rate[rows - 1]) / (t[rows + 1] - t[rows - 1])[:, None]
    turning = cross_matrix(rate[rows])
    columns = np.zeros((len(rows), 3, 6))  # a position, and what a bias adds
    columns[..., :3], columns[..., 3:] = turning @ turning + cross_matrix(spin), np.eye(3)
    off = force[rows] - force[rows].mean(axis=1, keepdims=True)
    flat = columns.reshape(-1, 6)
    value = off.transpose(0, 2, 1).reshape(len(flat), -1)
    found = np.linalg.lstsq(flat, value, rcond=None)[0]
    moved = value - flat[:, 3:] @ found[3:]
    if np.sum((value - flat @ found) ** 2) > (1.0 - _EXPLAINED) * np.sum(moved**2):
        return None
    return np.asarray(found[:3].T - found[:3].mean(axis=1))


def _placed(seen: Array, drawn: Array, mounted: Array) -> Places:
    from scipy.optimize import linear_sum_assignment

    size = float(np.sqrt(np.sum(seen**2) / np.sum(drawn**2)))
    scaled = seen if 1.0 / _SIZE < size < _SIZE else seen / size
    apart = np.sum((scaled[:, None] - drawn) ** 2, axis=2)
    as_drawn = np.diag(apart)
    mirrored = float(np.sum((scaled + drawn) ** 2))
    inverted = _CLEARER * mirrored < float(as_drawn.sum())
    if inverted:
        # Sensors in another order are likelier than all of them with the other sign.
        place, off = _in_another_order(scaled, drawn, mounted)
        if off <= _CLEARER * mirrored:
            return Places(seen, place, size, inverted=False)
    place = np.asarray(linear_sum_assignment(apart)[1], np.intp)
    moved = place != np.arange(len(place))
    nearer = apart[np.arange(len(place)), place]
    if inverted or _CLEARER * float(nearer[moved].sum()) > float(as_drawn[moved].sum()):
        place = np.arange(len(place))
    return Places(seen, place, size, inverted)


def _in_another_order(seen: Array, drawn: Array, mounted: Array) -> tuple[Index, float]:
    """(K,) places of the drawing in the order that fits best as a whole, and m² by which it does
    not: mountings go with places, so all readings are turned alike."""
    from scipy.optimize import linear_sum_assignment

    found, least = np.arange(len(seen)), np.inf
    turns = np.einsum("kij,lmj->klim", mounted, mounted)  # what k reads, mounted as l is
    for turn in turns[0]:
        alike = np.abs(turns - turn).max(axis=(2, 3)) < 1e-6
        apart = np.sum((seen[:, None] - drawn @ turn.T) ** 2, axis=2)
        cost = np.where(alike, apart, 1e6)
        place = np.asarray(linear_sum_assignment(cost)[1], np.intp)
        if (off := float(cost[np.arange(len(place)), place].sum())) < least:
            found, least = place, off
    return found, least
