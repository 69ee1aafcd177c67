"""What several calibrations have in common, as numbers with a full covariance each.

Where all hold the same parameters, these. Where they hold other effects, what they do to first
order: the linear map reading = S force + c that is nearest to theirs over all attitudes, with its
frame (S row by row) where all tie a frame to a tool or none does, else without it (lengths of S's
rows, angles between them).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import NEVER_APPLIED, Calibration
from imucalib.calibration.comparison.sensor import OneSensor, sensor_of
from imucalib.core.sphere import even_directions
from imucalib.units import DEG, MG

_ROUNDING = 1e-9  # mg, deg, or parts of one: what moves by less is touched by no parameter
_PAIRS = ((0, 1), (0, 2), (1, 2))


@dataclass(frozen=True)
class Basis:
    """p numbers of m calibrations. value : (m, p); covariance : (m, p, p); dof : (m,) behind each
    covariance's scale; words : what the numbers are, one sentence"""

    names: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    covariance: Array
    dof: Array
    words: str


def basis_of(calibrations: Sequence[Calibration], dof: Array, *, framed: bool) -> Basis:
    """framed : whether all tie a frame to a tool, or none does and all mean the same frame."""
    own = [_applied(c) for c in calibrations]
    if all(names == own[0] for names in own[1:]):
        at = [
            [k for k, p in enumerate(c.parameters) if p.stage not in NEVER_APPLIED or c.triads]
            for c in calibrations
        ]
        return Basis(
            names=tuple(name for name, _ in own[0]),
            units=tuple(unit for _, unit in own[0]),
            value=np.array([[c.parameters[k].value for k in ks] for c, ks in
                            zip(calibrations, at, strict=True)]),
            covariance=np.array([c.covariance[np.ix_(ks, ks)] for c, ks in
                                 zip(calibrations, at, strict=True)]),
            dof=dof,
            words="All hold the same parameters.",
        )  # fmt: skip
    every = [_linear(sensor_of(c), framed=framed) for c in calibrations]
    names, units = _names(framed)
    covariance = np.array([own for _, own in every])
    touched = np.flatnonzero(np.einsum("kii->ki", covariance).max(axis=0) > _ROUNDING**2)
    return Basis(
        names=tuple(names[k] for k in touched),
        units=tuple(units[k] for k in touched),
        value=np.array([value[touched] for value, _ in every]),
        covariance=covariance[:, touched][:, :, touched],
        dof=dof,
        words=f"They hold different effects ({_only(own)}): compared is what they do to first "
        f"order, reading = S force + c{'' if framed else ', free of the frame'}.",
    )


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


def _linear(sensor: OneSensor, *, framed: bool) -> tuple[Array, Array]:
    """The numbers of one calibration and their covariance, by its derivatives.

    Every direction stands beside its opposite: what is even in the force is none of S.
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
    return start, whole @ sensor.covariance @ whole.T
