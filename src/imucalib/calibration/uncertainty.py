"""Uncertainty carried from the parameters to what a user reads: inclination, tool-face, |a|.

Corrected specific force a = correct(reading) moves with the parameters as δa = -D⁻¹ J δθ, where J
and D are the derivatives of the predicted reading by the parameters and by the force in the tool's
frame. Then (paper 004, formulae (1) and (2), p. 2, differentiated):

    δ tool-face = (a_y δa_x - a_x δa_y) / (a_x² + a_y²)
    δ inclination = (h δa_z - a_z (a_x δa_x + a_y δa_y) / h) / |a|²,   h² = a_x² + a_y²
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import unit_vector
from imucalib.effects.record_error import is_record_error
from imucalib.units import DEG


@dataclass(frozen=True)
class AngleUncertainty:
    """For each attitude (n,): what the calibration alone leaves, and one reading adds.

    inclination_sd, tool_face_sd : deg, standard deviations from the parameters
    inclination_95, tool_face_95 : deg, half widths of 95 % intervals from the parameters
    inclination_reading, tool_face_reading : deg, standard deviation of one reading's noise
    """

    inclination: Array
    tool_face: Array
    inclination_sd: Array
    tool_face_sd: Array
    inclination_95: Array
    tool_face_95: Array
    inclination_reading: Array
    tool_face_reading: Array


def angle_uncertainty(
    fit: Fit, inclination: Array, tool_face: Array, gravity: float, reading_sigma: float
) -> AngleUncertainty:
    """Uncertainty of the angles computed from a corrected reading.

    inclination, tool_face : (n,) rad; gravity : m/s²; reading_sigma : m/s², noise of one reading
    """
    force = gravity * unit_vector(inclination, tool_face)[:, None]
    slope, inverse = force_slope(fit, force)
    x, y, z = force[:, 0].T
    h = np.maximum(np.hypot(x, y), 1e-12)
    along_t = np.stack([y, -x, np.zeros_like(x)], axis=-1) / (h**2)[:, None] / DEG
    along_i = np.stack([-z * x / h, -z * y / h, h], axis=-1) / gravity**2 / DEG
    rows_i = np.einsum("nj,njp->np", along_i, slope)
    rows_t = np.einsum("nj,njp->np", along_t, slope)

    def sd(rows: Array) -> Array:
        variance = np.einsum("np,pq,nq->n", rows, fit.covariance, rows)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), np.float64)

    def reading(along: Array) -> Array:
        moved = np.linalg.norm(np.einsum("nj,njk->nk", along, inverse), axis=-1)
        return np.asarray(reading_sigma * moved, np.float64)

    return AngleUncertainty(
        inclination=inclination / DEG,
        tool_face=tool_face / DEG,
        inclination_sd=sd(rows_i),
        tool_face_sd=sd(rows_t),
        inclination_95=fit.half_width(rows_i),
        tool_face_95=fit.half_width(rows_t),
        inclination_reading=reading(along_i),
        tool_face_reading=reading(along_t),
    )


def force_slope(fit: Fit, force: Array) -> tuple[Array, Array]:
    """d(corrected force)/dθ (n, 3, p) and d(corrected force)/d(reading) (n, 3, 3) at K = 1.

    The fixture's and single records' parameters do not act on a corrected reading: zero columns.
    """
    model = correcting(fit.model)
    context = Context(force.shape[0], _typical_covariates(fit, force.shape[0]))
    slices, own = fit.model.slices(fit.observations.context), model.slices(context)
    theta = model.start(context)
    for name, part in own.items():
        theta[part] = fit.theta[slices[name]]
    prediction = model.predict(theta, force, context)
    inverse = np.asarray(np.linalg.inv(prediction.d_truth[:, 0]), np.float64)
    slope = np.zeros((force.shape[0], 3, fit.theta.size))
    for name, part in own.items():
        slope[..., slices[name]] = -inverse @ prediction.d_theta[:, 0][..., part]
    return slope, inverse


def correcting(model: Model) -> Model:
    """The part of a model that `correct` undoes: mounting and sensor, without single records."""
    return Model(
        tuple(e for e in model.effects if e.stage != "fixture" and not is_record_error(e.name))
    )


def _typical_covariates(fit: Fit, n: int) -> dict[str, Array]:
    """Covariates at their median over the calibration, for attitudes that were never recorded."""
    covariates = fit.observations.context.covariates
    return {name: np.full(n, float(np.median(values))) for name, values in covariates.items()}


def corrected_by(fit: Fit, reading: Array) -> Array:
    """New readings (n, 3) m/s² corrected to specific force (n, 3) by a fit, K = 1."""
    model = correcting(fit.model)
    context = Context(len(reading), _typical_covariates(fit, len(reading)))
    slices = fit.model.slices(fit.observations.context)
    parts = [fit.theta[slices[name]] for name in model.names]
    theta = np.concatenate(parts) if parts else np.zeros(0)
    return model.correct(theta, reading[:, None], context)[:, 0]
