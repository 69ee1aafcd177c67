"""Which turns to take: what they tell of a gyroscope's gains, before they are taken.

Of a turn by φ about n, from gravity along u, the gains' columns are those of the joint fit
(`estimators/turns`), with the integral in closed form:

    Q_ij = n_j A e_i,    A = ∫ exp([n]x θ) dθ = φ n n' + sin φ (1 - n n') + (1 - cos φ) [n]x
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.gyroscope import GAIN
from imucalib.core.effect import cross_matrix, left_jacobian, rotations
from imucalib.core.eigen import eigen
from imucalib.errors import UnreadableInput
from imucalib.estimators.turns import tangents
from imucalib.posterior.closed_loop.planning import gain, grow_until
from imucalib.units import DEG

#: rad of a turn; rad that a turn by hand is off, of measured ones 0.03 to 0.3 deg.
ANGLE, _OFF = 135.0 * DEG, 0.1 * DEG
#: Standard deviation of a gain before any reading, and share of it that is open.
_KNOWN, _OPEN = 0.1, 0.5
_ADDED = 3


@dataclass(frozen=True)
class HandTurn:
    """A turn by `ANGLE` about a signed axis of the sensor. up : (3,) what its accelerometer reads
    before, in g; after : mean sd of the gains once it is taken"""

    axis: str
    up: Array
    after: float


@dataclass(frozen=True)
class HandPlan:
    """Turns in their order; sd : (9,) of the gains, rows first, after them; before : the same of
    what they are added to, or None; open_gains : combinations that stay open, in words"""

    turns: tuple[HandTurn, ...]
    sd: Array
    before: Array | None
    open_gains: tuple[str, ...]


def open_words(covariance: Array) -> tuple[str, ...]:
    """Combinations of the gains (9, 9) that are hardly known better than before any reading."""
    values, vectors = eigen(covariance)
    names = [f"{a}{b}" for a in "xyz" for b in "xyz"]
    found = []
    for k in np.flatnonzero(np.sqrt(values) > _OPEN * _KNOWN):
        share = vectors[:, k]
        big = np.argsort(-np.abs(share))[:3]
        words = " ".join(f"{share[i]:+.1f} {names[i]}" for i in big if abs(share[i]) > 0.3)
        found.append(f"the gains {words} of the gyroscope")
    return tuple(found)


def of_turn(up: Array, vector: Array) -> Array:
    """(2, 9) columns of the gains, of a turn by the rotation vector (3,) from gravity along up."""
    angle = float(np.linalg.norm(vector))
    n, whole = vector / angle, rotations(vector)
    swept = angle * left_jacobian(vector)
    across = tangents((whole.T @ up)[None])[0]
    moved = across.T @ whole.T @ cross_matrix(up) @ swept
    return np.asarray(np.einsum("ai,j->aij", moved, n).reshape(2, 9))


def hand_plan(rests: int) -> HandPlan:
    """135 deg about x, y and z in turn, every second round backwards, from z up: as good as the
    D-optimal plan, and to hold in the hand."""
    up, chosen = np.array([0.0, 0.0, 1.0]), list[tuple[Array, Array]]()
    for k in range(rests - 1):
        vector = (-1.0 if k // 3 % 2 else 1.0) * ANGLE * np.eye(3)[k % 3]
        chosen.append((up, vector))
        up = rotations(vector).T @ up
    return _plan(chosen, np.eye(9) / _KNOWN**2, _OFF, None)


def turns_to_add(calibration: Calibration, count: int = _ADDED) -> HandPlan:
    """The turns that are expected to tell most of a calibration's gains, from any face, edge or
    corner. Raises UnreadableInput where it has no gyroscope."""
    at = [k for k, p in enumerate(calibration.parameters) if p.effect == GAIN]
    if not at:
        raise UnreadableInput(
            f"this is a calibration by {calibration.calibrator}, without the gains of a gyroscope",
            remedy="`imucal imu` makes one",
        )
    covariance = calibration.covariance[np.ix_(at, at)]
    before, own = np.sqrt(np.diag(covariance)), calibration.facts.get("imu", {})
    off = _off(own)
    choices = [
        (np.array(up) / np.linalg.norm(up), sign * ANGLE * np.eye(3)[axis])
        for up in product((-1.0, 0.0, 1.0), repeat=3)
        if any(up)
        for axis in range(3)
        for sign in (1.0, -1.0)
    ]
    known = np.asarray(np.linalg.inv(covariance), np.float64)
    worth = gain(known, np.array([_inform(*choice, off) for choice in choices]))
    plan = grow_until(worth, count, lambda _: False)
    return _plan([choices[place] for place in plan], known, off, before)


def _inform(up: Array, vector: Array, off: float) -> Array:
    """(9, 9) what a turn tells that is off by so much, rad."""
    rows = of_turn(up, vector) / off
    return np.asarray(rows.T @ rows)


def _off(own: Mapping[str, float]) -> float:
    """rad of one more turn, as those were that a calibration has."""
    floor, share = (own.get(n, 0.0) for n in ("turn_floor_deg", "turn_error_per_angle"))
    found = float(np.hypot(floor * DEG, share * ANGLE))
    return max(found, 0.2 * _OFF) if own else _OFF


def _plan(
    chosen: Sequence[tuple[Array, Array]], known: Array, off: float, before: Array | None
) -> HandPlan:
    """Of turns from `up` by a rotation vector, beside information (9, 9) that is there."""
    turns, covariance = list[HandTurn](), np.asarray(np.linalg.inv(known), np.float64)
    for up, vector in chosen:
        known = known + _inform(up, vector, off)
        covariance = np.asarray(np.linalg.inv(known), np.float64)
        mean = float(np.sqrt(np.mean(np.diag(covariance))))
        turns.append(HandTurn(_axis(vector), up, mean))
    return HandPlan(tuple(turns), np.sqrt(np.diag(covariance)), before, open_words(covariance))


def _axis(vector: Array) -> str:
    k = int(np.argmax(np.abs(vector)))
    return ("-" if vector[k] < 0.0 else "+") + "xyz"[k]
