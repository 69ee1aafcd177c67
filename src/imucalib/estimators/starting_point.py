"""A starting point from anywhere: the full linear map in closed form, split into physics.

reading = S x + c by linear least squares on the nominal truth; then S = K R with K lower
triangular (scale, non-orthogonality) and R a rotation (mounting). Works for any mounting of the
sensor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import vector_of
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.errors import UnreadableInput
from imucalib.units import DEG, MG

#: Steps in which the rows that make the map are found.
_STEPS = 20


def full_matrix_start(model: Model, observations: Observations) -> Array:
    """θ to start from; the effects' own starting values where there is no vector reference.

    Raises UnreadableInput when the map mirrors space: an axis or the tool-face has the wrong sign.
    """
    theta = model.start(observations.context)
    reference = observations.reference
    if not reference.directed or "mounting" not in model.names:
        return theta
    sensitivity, offset, rank = linear_map(observations)
    if rank < 4:
        return theta
    if np.linalg.det(sensitivity) <= 0.0:  # of a part of the rows, perhaps
        sensitivity, offset, _ = linear_map(observations.take(consistent_rows(observations)))
    if np.linalg.det(sensitivity) <= 0.0:
        raise UnreadableInput(
            "the readings are a mirror image of the reference: an axis has the other sign",
            remedy="check the signs of x, y and z; "
            + (
                "an angle may turn the other way: --toolface-sense counter-clockwise"
                if isinstance(reference, KnownVector)
                else "a face is the axis that reads +g, which is the one that points up"
            ),
        )
    lower, rotation = _lower_times_rotation(sensitivity)
    slices = model.slices(observations.context)
    theta[slices["mounting"]] = vector_of(rotation) / DEG
    theta[slices["scale"]] = np.diag(lower) - 1.0
    theta[slices["non_orthogonality"]] = [lower[1, 0], lower[2, 0], lower[2, 1]]
    theta[slices["bias"]] = offset / MG
    return theta


def consistent_rows(observations: Observations) -> Index:
    """The larger part of the rows (K = 1, known directions) that fit one linear map best."""
    return larger_part(_design(observations), observations.reading[:, 0]).rows


@dataclass(frozen=True)
class Concentrated:
    """misfit : sum of the sizes that the rows leave, infinite where they carry no map; rows : that
    fit best; map : (p, 3) what they make of the design, or None"""

    misfit: float
    rows: Index
    map: Array | None


def larger_part(design: Array, reading: Array) -> Concentrated:
    """The rows that fit one linear map best, as many as break down last (Rousseeuw and Leroy 1987,
    section 3.4), from all, from those in front and from those at the end. design : (n, p)"""
    n, columns = design.shape
    many = min(max(columns + 1, (n + columns + 1) // 2), n)
    starts = (np.arange(n), np.arange(many), np.arange(n - many, n))
    found = (concentrate(design, reading, start, many) for start in starts)
    return min(found, key=lambda f: f.misfit)


def concentrate(design: Array, reading: Array, rows: Index, many: int) -> Concentrated:
    """So `many` rows that fit one linear map best, by concentration steps from some (Rousseeuw and
    Van Driessen 1999). design : (n, p); reading : (n, 3)"""
    for _ in range(_STEPS):
        made, _, rank, _ = np.linalg.lstsq(design[rows], reading[rows], rcond=1e-6)
        if rank < design.shape[1]:
            return Concentrated(np.inf, rows, None)
        size = np.linalg.norm(reading - design @ made, axis=1)
        best = np.sort(np.argsort(size)[:many])
        if np.array_equal(best, rows):
            break
        rows = best
    return Concentrated(float(size[best].sum()), rows, np.asarray(made))


def linear_map(observations: Observations) -> tuple[Array, Array, int]:
    """S (3, 3), c (3,) m/s² and the rank of the design, for K = 1."""
    design = _design(observations)
    found, _, rank, _ = np.linalg.lstsq(design, observations.reading[:, 0], rcond=1e-6)
    solution = np.asarray(found, np.float64)
    return solution[:3].T, solution[3], int(rank)


def _design(observations: Observations) -> Array:
    """(n, 4) the truth that was meant, m/s², and one."""
    reference = observations.reference
    truth = reference.truth(np.zeros(reference.eta_size))[:, 0]
    return np.column_stack([truth, np.ones(len(truth))])


def _lower_times_rotation(matrix: Array) -> tuple[Array, Array]:
    q, r = np.linalg.qr(matrix.T)
    sign = np.where(np.diag(r) < 0.0, -1.0, 1.0)
    return (r * sign[:, None]).T, (q * sign).T
