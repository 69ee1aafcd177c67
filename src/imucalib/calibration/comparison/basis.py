"""What several calibrations have in common, as numbers with a full covariance each.

Where all hold the same parameters, these. Where they hold other effects, what they do to first
order: the linear map reading = S force + c that is nearest to theirs over all attitudes, with its
frame (S row by row) where all tie a frame to a tool or none does, else without it (lengths of S's
rows, angles between them).

A calibrated sensor as it acts: readings of a force, the force of a reading, and how both move
with the calibration's parameters. The same for a single accelerometer and for an IMU of an array.

What a difference between calibrations means: the corrected force in every attitude.

The first calibration's reading of gravity, f(u) = g u, is corrected by the other. Its size may be
compared always, its direction where both mean the same frame. Standard deviations carry the full
covariances of both, S C Sᵀ with S the slope of the corrected force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration
from imucalib.calibration.checking.next_rests import Acting, acting
from imucalib.calibration.triads import Triad
from imucalib.core.effect import Context
from imucalib.core.references import tangents
from imucalib.core.sphere import even_directions
from imucalib.units import DEG, MG


class CalibratedSensor(Protocol):
    """Vectors are (n, 3) m/s²."""

    @property
    def covariance(self) -> Array:
        """(p, p) of the parameters that act."""
        ...

    def reading(self, force: Array) -> Array: ...
    def force(self, reading: Array) -> Array: ...
    def slope(self, force: Array) -> Array:
        """(n, 3, p) of the corrected force by the parameters, at a reading of `force`."""
        ...


@dataclass(frozen=True)
class OneSensor:
    """A calibration with covariates where a later reading finds them."""

    calibration: Calibration
    part: Acting

    @property
    def covariance(self) -> Array:
        return self.calibration.covariance[np.ix_(self.part.at, self.part.at)]

    def _context(self, n: int) -> Context:
        before = {f"previous_{axis}": np.zeros(n) for axis in "xyz"}
        return Context(n, {**before, **self.calibration.usual(n)})

    def reading(self, force: Array) -> Array:
        part, context = self.part, self._context(len(force))
        return part.model.predict(part.theta, force[:, None], context).reading[:, 0]

    def force(self, reading: Array) -> Array:
        part, context = self.part, self._context(len(reading))
        return part.model.correct(part.theta, reading[:, None], context)[:, 0]

    def slope(self, force: Array) -> Array:
        part = self.part
        seen = part.model.predict(part.theta, force[:, None], self._context(len(force)))
        return np.asarray(-np.linalg.solve(seen.d_truth[:, 0], seen.d_theta[:, 0]))

    def reading_slope(self, force: Array) -> Array:
        """(n, 3, p) of the reading by the parameters."""
        part = self.part
        seen = part.model.predict(part.theta, force[:, None], self._context(len(force)))
        return seen.d_theta[:, 0]


def sensor_of(calibration: Calibration) -> OneSensor:
    """Raises UnreadableInput for effects that are not known."""
    return OneSensor(calibration, acting(calibration, fixture=False))


@dataclass(frozen=True)
class ArrayImu:
    """One IMU, in board axes: reading = gain · force + bias."""

    triad: Triad

    @property
    def covariance(self) -> Array:
        return self.triad.covariance

    def reading(self, force: Array) -> Array:
        return np.asarray(force @ self.triad.gain.T + self.triad.bias)

    def force(self, reading: Array) -> Array:
        return np.asarray(np.linalg.solve(self.triad.gain, (reading - self.triad.bias).T).T)

    def slope(self, force: Array) -> Array:
        n = len(force)
        by_gain = np.einsum("ij,nk->nijk", np.eye(3), force).reshape(n, 3, 9)
        both = np.concatenate([by_gain, np.broadcast_to(np.eye(3), (n, 3, 3))], axis=2)
        return np.asarray(-np.linalg.solve(self.triad.gain, both))


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


_ROUNDING = 1e-9  # mg, deg, or parts of one: what moves by less is touched by no parameter
_PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class PowerUps:
    """share : of each covariance, what power-ups bring; dof : behind its scale, one for all"""

    share: Sequence[Array]
    dof: float


@dataclass(frozen=True)
class Basis:
    """p numbers of m calibrations. value : (m, p); covariance : (m, p, p); dof : (m,) behind each
    covariance's scale; words : what the numbers are, one sentence
    power_ups : of the covariances, None where nothing tells what they bring
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    covariance: Array
    dof: Array
    words: str
    power_ups: PowerUps | None = None


def basis_of(
    calibrations: Sequence[Calibration],
    dof: Array,
    *,
    framed: bool,
    power_ups: PowerUps | None = None,
) -> Basis:
    """framed : whether all tie a frame to a tool, or none does and all mean the same frame
    power_ups : of the calibrations' own covariances"""
    own = [_applied(c) for c in calibrations]
    if all(names == own[0] for names in own[1:]):
        return _of_parameters(calibrations, dof, power_ups)
    share = [np.zeros_like(c.covariance) for c in calibrations]
    if power_ups is not None:
        share = list(power_ups.share)
    every = [
        _linear(sensor_of(c), part, framed=framed)
        for c, part in zip(calibrations, share, strict=True)
    ]
    names, units = _names(framed)
    covariance = np.array([own for _, own, _ in every])
    touched = np.flatnonzero(np.einsum("kii->ki", covariance).max(axis=0) > _ROUNDING**2)
    both = np.ix_(touched, touched)
    return Basis(
        names=tuple(names[k] for k in touched),
        units=tuple(units[k] for k in touched),
        value=np.array([value[touched] for value, _, _ in every]),
        covariance=np.array([own[both] for own in covariance]),
        dof=dof,
        words=f"They hold different effects ({_only(own)}): compared is what they do to first "
        f"order, reading = S force + c{'' if framed else ', free of the frame'}.",
        power_ups=power_ups and replace(power_ups, share=[part[both] for _, _, part in every]),
    )


def _of_parameters(
    calibrations: Sequence[Calibration], dof: Array, power_ups: PowerUps | None
) -> Basis:
    """Of calibrations that hold the same."""
    at = [
        [k for k, p in enumerate(c.parameters) if p.stage not in NEVER_APPLIED or c.triads]
        for c in calibrations
    ]
    first = _applied(calibrations[0])

    def taken(every: Sequence[Array]) -> Array:
        return np.array([one[np.ix_(ks, ks)] for one, ks in zip(every, at, strict=True)])

    return Basis(
        names=tuple(name for name, _ in first),
        units=tuple(unit for _, unit in first),
        value=np.array(
            [[c.parameters[k].value for k in ks] for c, ks in zip(calibrations, at, strict=True)]
        ),
        covariance=taken([c.covariance for c in calibrations]),
        dof=dof,
        words="All hold the same parameters.",
        power_ups=power_ups and replace(power_ups, share=list(taken(power_ups.share))),
    )


def _applied(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Name and unit of what acts on a reading; of an array, its positions."""
    return tuple(
        (p.name, p.unit)
        for p in calibration.parameters
        if p.stage not in NEVER_APPLIED or calibration.triads
    )


def _only(own: Sequence[tuple[tuple[str, str], ...]]) -> str:
    """What not all of them hold."""
    every = [{name for name, _ in names} for names in own]
    some = sorted({n for names in every for n in names if not all(n in o for o in every)})
    more = f", and {len(some) - 4} more" if len(some) > 4 else ""
    return f"not in all: {', '.join(some[:4])}{more}" if some else "other units"


def _names(framed: bool) -> tuple[tuple[str, ...], tuple[str, ...]]:
    offsets = tuple(f"offset_{a}" for a in "xyz")
    if framed:
        gains = tuple(f"S_{a}{b}" for a in "xyz" for b in "xyz")
        return (*offsets, *gains), ("mg",) * 3 + ("1",) * 9
    shape = (*(f"scale_{a}" for a in "xyz"), "angle_xy", "angle_xz", "angle_yz")
    return (*offsets, *shape), ("mg",) * 3 + ("1",) * 3 + ("deg",) * 3


def _linear(sensor: OneSensor, part: Array, *, framed: bool) -> tuple[Array, Array, Array]:
    """The numbers of one calibration, their covariance and that of a part, by its derivatives.

    part : (p, p) of all of the calibration's parameters. Every direction stands beside its
    opposite: what is even in the force is none of S.
    """
    half = even_directions(60)
    force = sensor.calibration.gravity * np.concatenate([half, -half])
    design = np.concatenate([np.ones((len(force), 1)), force], axis=1)
    operator = np.linalg.pinv(design)
    # (4, 3): c over Sᵀ; its derivative (4, 3, p).
    fitted = operator @ sensor.reading(force)
    slope = np.einsum("an,nip->aip", operator, sensor.reading_slope(force))

    def numbers(values: Array) -> Array:
        offset, gain = values[0] / MG, values[1:].T
        if framed:
            return np.concatenate([offset, gain.ravel()])
        length = np.linalg.norm(gain, axis=1)
        cosine = [gain[i] @ gain[j] / length[i] / length[j] for i, j in _PAIRS]
        return np.concatenate([offset, length, np.arccos(cosine) / DEG])

    start, step = numbers(fitted), 1e-6
    jacobian = np.zeros((start.size, fitted.size))
    for k in range(fitted.size):
        moved = fitted.copy()
        moved.flat[k] += step
        jacobian[:, k] = (numbers(moved) - start) / step
    whole = jacobian @ slope.reshape(fitted.size, -1)
    at = sensor.part.at
    return start, whole @ sensor.covariance @ whole.T, whole @ part[np.ix_(at, at)] @ whole.T
