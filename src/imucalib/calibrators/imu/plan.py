"""Which turns to take: what they tell of a gyroscope's gains, before they are taken.

Of a turn by φ about n, from gravity along u, the gains' columns are those of the joint fit
(`estimators/turns`), with the integral in closed form:

    Q_ij = n_j A e_i,    A = ∫ exp([n]x θ) dθ = φ n n' + sin φ (1 - n n') + (1 - cos φ) [n]x
"""

from __future__ import annotations

from collections.abc import Mapping
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
from imucalib.loop.planning import Plan, grow, nats
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
    up, covariance = np.array([0.0, 0.0, 1.0]), _KNOWN**2 * np.eye(9)
    turns = []
    for k in range(rests - 1):
        sign = -1.0 if k // 3 % 2 else 1.0
        vector = sign * ANGLE * np.eye(3)[k % 3]
        covariance = _after(covariance, of_turn(up, vector), _OFF)
        turns.append(HandTurn(_axis(vector), up, _mean(covariance)))
        up = rotations(vector).T @ up
    return _plan(turns, covariance, None)


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
    told = np.array([of_turn(up, vector) for up, vector in choices]) / off
    each = told.transpose(0, 2, 1) @ told
    known = _inverse(covariance)
    plan: Plan = ()
    for _ in range(count):
        plan = grow(plan, lambda plan: nats(known + each[list(plan)].sum(axis=0) + each))
    turns = []
    for place in plan:
        known = known + each[place]
        up, vector = choices[place]
        turns.append(HandTurn(_axis(vector), up, _mean(_inverse(known))))
    return _plan(turns, _inverse(known), before)


def _after(covariance: Array, rows: Array, off: float) -> Array:
    """(9, 9) once a turn with columns (2, 9) is taken. off : rad"""
    shared = rows @ covariance
    inner = shared @ rows.T + off**2 * np.eye(2)
    return np.asarray(covariance - shared.T @ np.linalg.solve(inner, shared))


def _off(own: Mapping[str, float]) -> float:
    """rad of one more turn, as those were that a calibration has."""
    floor, share = (own.get(n, 0.0) for n in ("turn_floor_deg", "turn_error_per_angle"))
    found = float(np.hypot(floor * DEG, share * ANGLE))
    return max(found, 0.2 * _OFF) if own else _OFF


def _plan(turns: list[HandTurn], covariance: Array, before: Array | None) -> HandPlan:
    return HandPlan(tuple(turns), np.sqrt(np.diag(covariance)), before, open_words(covariance))


def _axis(vector: Array) -> str:
    k = int(np.argmax(np.abs(vector)))
    return ("-" if vector[k] < 0.0 else "+") + "xyz"[k]


def _inverse(matrix: Array) -> Array:
    return np.asarray(np.linalg.inv(matrix), np.float64)


def _mean(covariance: Array) -> float:
    return float(np.sqrt(np.mean(np.diag(covariance))))
