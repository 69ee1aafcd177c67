"""Objectives on the corrected reading: the paper's (5), and the angles that it suggests.

Both compare a = correct(reading) with the reference, so their residuals' derivative by the
parameters is -D⁻¹ J of the prediction. They take the reference angles as exact. Kept for comparison
with published results; `least_squares` is the estimator whose uncertainty can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.fit import Fit, null_directions
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector, angle_slopes, angles_of, unit_vector
from imucalib.errors import NotConverged, UsageError
from imucalib.estimators.least_squares import evaluate
from imucalib.estimators.levenberg_marquardt import minimise

#: (corrected (n, 3), reference) -> residual (r,) and its derivative by the corrected (r, n, 3)
Objective = Callable[[Array, KnownVector], tuple[Array, Array]]


def paper(corrected: Array, reference: KnownVector) -> tuple[Array, Array]:
    """Paper 004, objective (5), p. 4: aligned positions as vectors, all positions by the norm.

    Aligned are the first rows within 0.5 degrees of +x, +y and +z, those that there are.
    """
    g, n = reference.gravity, len(corrected)
    size = np.linalg.norm(corrected, axis=1)
    residual, slope = [size / g - 1.0], [np.zeros((n, n, 3))]
    slope[0][np.arange(n), np.arange(n)] = corrected / size[:, None] / g
    nominal = unit_vector(reference.inclination, reference.tool_face)
    for axis in np.eye(3):
        aligned = np.flatnonzero(nominal @ axis > np.cos(np.radians(0.5)))
        if aligned.size:
            row = int(aligned[0])
            residual.append((corrected[row] - g * axis) / g)
            part = np.zeros((3, n, 3))
            part[:, row] = np.eye(3) / g
            slope.append(part)
    return np.concatenate(residual), np.concatenate(slope)


def angles(corrected: Array, reference: KnownVector) -> tuple[Array, Array]:
    """Inclination, tool-face times cos(inclination), and the norm: paper 004, section 4, p. 7.

    The weight is what one reading's noise does to the tool-face, so steep positions count as
    much as they know.
    """
    n = len(corrected)
    i, t = angles_of(corrected)
    turn = np.mod(t - reference.tool_face + np.pi, 2.0 * np.pi) - np.pi
    weight = np.cos(reference.inclination)
    size = np.linalg.norm(corrected, axis=1)
    residual = np.concatenate(
        [i - reference.inclination, weight * turn, size / reference.gravity - 1.0]
    )
    by_i, by_t = angle_slopes(corrected)
    by_n = corrected / size[:, None] / reference.gravity
    slope = np.zeros((3 * n, n, 3))
    rows = np.arange(n)
    for block, part in enumerate((by_i, weight[:, None] * by_t, by_n)):
        slope[block * n + rows, rows] = part
    return residual, slope


OBJECTIVES: dict[str, Objective] = {"paper": paper, "angles": angles}


def fit_corrected(model: Model, observations: Observations, objective: str, start: Array) -> Fit:
    """Minimise an objective over θ. The covariance is σ² (GᵀG)⁻¹ with σ from the objective itself.

    Raises UsageError without a vector reference, and NotConverged.
    """
    reference, context = observations.reference, observations.context
    if not isinstance(reference, KnownVector):
        raise UsageError(f"objective '{objective}' needs known angles")
    compare = OBJECTIVES[objective]

    def linearise(theta: Array) -> tuple[Array, Array]:
        corrected = model.correct(theta, observations.reading, context)
        prediction = model.predict(theta, corrected, context)
        by_theta = -np.linalg.solve(prediction.d_truth, prediction.d_theta)[:, 0]
        residual, slope = compare(corrected[:, 0], reference)
        return residual, -np.einsum("rnj,njp->rp", slope, by_theta)

    solution = minimise(linearise, lambda theta, step: theta + step, start, iterations=500)
    if not solution.converged:
        raise NotConverged(f"objective '{objective}' did not converge")
    dof = max(solution.residual.size - start.size, 1)
    variance = float(solution.residual @ solution.residual) / dof
    inverse = np.linalg.pinv(solution.jacobian.T @ solution.jacobian, rcond=1e-14)
    covariance = np.asarray(variance * inverse, np.float64)
    noise = Noise(1.0, KnownVector.COMPONENTS, (0.005, 0.005)) if reference.setting_errors else None
    parameters = model.parameters(context)
    open_directions = null_directions(solution.jacobian, parameters, float(np.sqrt(variance)))
    found = evaluate(model, observations, solution.state, covariance, noise)
    return replace(found, null_directions=open_directions)
