"""Uncertainty carried from the parameters to what a user reads: inclination, tool-face, |a|.

Corrected specific force a = correct(reading) moves with the parameters as δa = -D⁻¹ J δθ, where J
and D are the derivatives of the predicted reading by the parameters and by the force in the tool's
frame; angles as of `core.references.angle_slopes`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.references import angle_slopes, unit_vector
from imucalib.effects.record_error import is_record_error
from imucalib.units import DEG


def select_correctable(model: Model) -> Model:
    """The part of a model that `correct` undoes: mounting and sensor, without single records."""
    return Model(
        tuple(e for e in model.effects if e.stage != "fixture" and not is_record_error(e.name))
    )


def force_slopes(model: Model, theta: Array, force: Array, context: Context) -> tuple[Array, Array]:
    """d(corrected force)/dθ (n, 3, p) and d(corrected force)/d(reading) (n, 3, 3) of a correcting
    model at forces (n, 3) m/s²."""
    seen = model.predict(theta, force[:, None], context)
    inverse = np.asarray(np.linalg.inv(seen.d_truth[:, 0]), np.float64)
    return -inverse @ seen.d_theta[:, 0], inverse


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
    force = gravity * unit_vector(inclination, tool_face)
    slope, inverse = force_slope(fit, force)
    along = angle_slopes(force) / DEG
    rows = np.einsum("anj,njp->anp", along, slope)
    variance = np.einsum("anp,pq,anq->an", rows, fit.covariance, rows)
    sd = np.sqrt(np.maximum(variance, 0.0))
    reading = reading_sigma * np.linalg.norm(np.einsum("anj,njk->ank", along, inverse), axis=-1)
    return AngleUncertainty(
        inclination=inclination / DEG,
        tool_face=tool_face / DEG,
        inclination_sd=sd[0],
        tool_face_sd=sd[1],
        inclination_95=fit.half_width(rows[0]),
        tool_face_95=fit.half_width(rows[1]),
        inclination_reading=reading[0],
        tool_face_reading=reading[1],
    )


def force_slope(fit: Fit, force: Array) -> tuple[Array, Array]:
    """`force_slopes` of a fit at forces (n, 3) m/s², by all of its parameters.

    The fixture's and single records' parameters do not act on a corrected reading: zero columns.
    """
    model, theta, context = _select_corrector(fit, len(force))
    own, inverse = force_slopes(model, theta, force, context)
    slices = fit.model.slices(fit.observations.context)
    slope = np.zeros((*own.shape[:2], fit.theta.size))
    for name, part in model.slices(context).items():
        slope[..., slices[name]] = own[..., part]
    return slope, inverse


def predict_readings(fit: Fit, force: Array) -> Array:
    """Readings (n, 3) m/s² that `correct_readings` takes to specific forces (n, 3) m/s²."""
    model, theta, context = _select_corrector(fit, len(force))
    return model.predict(theta, force[:, None], context).reading[:, 0]


def correct_readings(fit: Fit, reading: Array) -> Array:
    """New readings (n, 3) m/s² corrected to specific force (n, 3) by a fit, K = 1, covariates at
    their median over the calibration."""
    model, theta, context = _select_corrector(fit, len(reading))
    return model.correct(theta, reading[:, None], context)[:, 0]


def corrector(fit: Fit) -> Callable[[Array, Index], Array]:
    """What corrects readings (n, 3) m/s² as observations (n,) of the fit are, at the covariates of
    these; K = 1."""
    model, theta, _ = _select_corrector(fit, 1)
    context = fit.observations.context

    def correct(reading: Array, like: Index) -> Array:
        return model.correct(theta, reading[:, None], context.take(like))[:, 0]

    return correct


def _select_corrector(fit: Fit, n: int) -> tuple[Model, Array, Context]:
    """What of a fit corrects n readings: covariates at their median over the calibration."""
    model, slices = select_correctable(fit.model), fit.model.slices(fit.observations.context)
    covariates = fit.observations.context.covariates
    typical = {name: np.full(n, float(np.median(values))) for name, values in covariates.items()}
    theta = np.concatenate([np.zeros(0), *(fit.theta[slices[name]] for name in model.names)])
    return model, theta, Context(n, typical)
