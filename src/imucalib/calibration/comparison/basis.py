"""What several calibrations have in common, as numbers with a full covariance each.

Where all hold the same parameters, these. Where they hold other effects, what they do to first
order: the linear map reading = S force + c that is nearest to theirs over all attitudes, with its
frame (S row by row) where all tie a frame to a tool or none does, else without it (lengths of S's
rows, angles between them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration
from imucalib.calibration.comparison.sensor import OneSensor, sensor_of
from imucalib.core.sphere import even_directions
from imucalib.units import DEG, MG

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
    every = [_linear(sensor_of(c), part, framed=framed) for c, part in
             zip(calibrations, share, strict=True)]  # fmt: skip
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
        value=np.array([[c.parameters[k].value for k in ks] for c, ks in
                        zip(calibrations, at, strict=True)]),
        covariance=taken([c.covariance for c in calibrations]),
        dof=dof,
        words="All hold the same parameters.",
        power_ups=power_ups and replace(power_ups, share=list(taken(power_ups.share))),
    )  # fmt: skip


def _applied(calibration: Calibration) -> tuple[tuple[str, str], ...]:
    """Name and unit of what acts on a reading; of an array, its positions."""
    return tuple(
        (p.name, p.unit) for p in calibration.parameters
        if p.stage not in NEVER_APPLIED or calibration.triads
    )  # fmt: skip


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
