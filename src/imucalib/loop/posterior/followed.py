"""The course of a bias that wanders, where it is the sensor's: the walk's posterior mean, followed.

Given what is read, the walk at any moments g is normal, C its covariance with the readings:

    w_g | y, θ ~ N(Cᵀ V⁻¹ (y - X θ),  K_gg - Cᵀ V⁻¹ C)

A calibration holds it as a smooth curve of time. It is followed only where short stretches of the
recording, each predicted by the others, prove that it tells what a reading there is off by.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects.curve import curve
from imucalib.loop.difference import difference
from imucalib.loop.posterior.recorded import Course, fit_at
from imucalib.loop.posterior.walk import whitener
from imucalib.units import MG

#: Short stretches of a recording, every twelfth of which is predicted by the others: as far from
#: what was recorded as a reading that is corrected may be.
_STRETCHES, _FOLDS = 120, 12
#: Cosines of the curve, and moments of each at which the walk is asked.
_TERMS, _MOMENTS = 24, 4
_UNKNOWN = 1e8  # times the variance of a run that is left out


def followed(fit: Fit, course: Course) -> Fit | None:
    """The fit with the course of its bias, or None where nothing proves that there is one to
    follow; course : the noise beside the fit."""
    misfit = fit.at.residual * fit.at.unit / course.scatter
    if not course.likeliest.size.any() or not _proved(course, misfit):
        return None
    walk = _asked(fit, course, misfit)
    time = course.time
    effect = curve(f"bias:time:{time[0]:.10g}:{time[-1]:.10g}:{_TERMS}")
    model = Model((*fit.model.effects, effect))
    return _joined(fit, model, effect.name, walk)


def _proved(course: Course, misfit: Array) -> bool:
    """Whether stretches that are left out are predicted better with the walk, beyond chance."""
    time, walk = course.time, course.likeliest
    unit = (time - time[0]) / max(float(np.ptp(time)), 1e-300)
    stretch = np.minimum((_STRETCHES * unit).astype(int), _STRETCHES - 1)
    out = stretch % _FOLDS == np.arange(_FOLDS)[:, None]
    variance = course.variance * np.where(out, _UNKNOWN, 1.0)
    shares = (course.shares * walk.size)[None]
    white = whitener(time, variance, shares, np.full(_FOLDS, walk.memory))
    left = variance * white.back(white(misfit[:, None]))[..., 0]
    after = left[stretch % _FOLDS, np.arange(time.size)]
    return difference(np.abs(misfit), np.abs(after), stretch, _FOLDS, "mean").plain_low > 0.0


@dataclass(frozen=True)
class _Course:
    """Of the walk as a constant and cosines of time, mg, axis by axis: mean (3, 1 + T), slope by θ
    (3 (1 + T), p), covariance; left : mg², what these cannot express of an axis' bias"""

    mean: Array
    slope: Array
    covariance: Array
    left: float


def _asked(fit: Fit, course: Course, misfit: Array) -> _Course:
    time, walk, size = course.time, course.likeliest, course.scatter / MG
    asked = np.linspace(time[0], time[-1], _MOMENTS * _TERMS)
    near = np.exp(-np.abs(time[:, None] - asked) / walk.memory)
    apart = np.exp(-np.abs(asked[:, None] - asked) / walk.memory)
    across = [walk.size[a] ** 2 * course.shares[:, a : a + 1] * near for a in range(3)]
    unit = (fit.at.unit / course.scatter)[:, None]
    white = course.whitener((walk,))(np.column_stack([misfit, fit.at.jacobian * unit, *across]))[0]
    p, g = fit.theta.size, asked.size
    r, x, c = white[:, 0], white[:, 1 : 1 + p], white[:, 1 + p :]
    prior = np.kron(np.diag(walk.size**2), apart)
    spread = prior - c.T @ c
    # A constant and cosines nearest to the course.
    phase = np.pi * (asked - time[0]) / np.ptp(time)
    basis = np.cos(np.arange(_TERMS + 1) * phase[:, None])
    nearest = np.linalg.pinv(basis)
    turn = np.kron(np.eye(3), nearest)
    mean = (c.T @ r).reshape(3, g)
    lost = np.kron(np.eye(3), np.eye(g) - basis @ nearest)
    rough = float(np.mean(np.diag(lost @ spread @ lost.T))) + float(
        np.mean((mean - mean @ nearest.T @ basis.T) ** 2)
    )
    return _Course(
        mean=size * mean @ nearest.T,
        slope=-size * turn @ (c.T @ x),
        covariance=size**2 * turn @ spread @ turn.T,
        left=size**2 * rough,
    )


def _joined(fit: Fit, model: Model, name: str, walk: _Course) -> Fit:
    """The fit with the curve in it: the constant is the bias' own."""
    context, p = fit.observations.context, fit.theta.size
    slices, own = model.slices(context), fit.model.slices(context)
    count = 3 * (_TERMS + 1)
    turn = np.zeros((len(model.parameters(context)), p + count))
    for effect, part in own.items():
        turn[slices[effect], part] = np.eye(part.stop - part.start)
    at = p + np.arange(count).reshape(3, -1)
    bias = np.arange(slices["bias"].start, slices["bias"].stop)
    turn[bias, at[:, 0]] = 1.0
    turn[np.arange(slices[name].start, slices[name].stop), at[:, 1:].ravel()] = 1.0
    theta = turn @ np.concatenate([fit.theta, walk.mean.ravel()])
    inner = fit.covariance
    cross = walk.slope @ inner
    whole = np.block(
        [[inner, cross.T], [cross, walk.covariance + walk.slope @ inner @ walk.slope.T]]
    )
    covariance = turn @ whole @ turn.T
    covariance[bias, bias] += walk.left
    return fit_at(model, fit.observations, theta, 0.5 * (covariance + covariance.T))
