"""The highest point of the array posterior and the Gaussian that touches it there.

The frame x = mode + L z, L Lᵀ the inverse of the true Hessian, is what both the sampler and
quick answers use. The Hessian comes from one batched call of the gradient.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.eigen import eigen
from imucalib.errors import NotConverged
from imucalib.estimators.array.likelihood import ArrayPosterior, conditionals
from imucalib.estimators.array.problem import ArrayData, ArrayPrior
from imucalib.estimators.array.rates import cross

_FEW = 300  # samples on which the first steps are taken
_REFRESHES = 25
_LONGEST = 1.0  # prior standard deviations of a step
_NOTICED = 0.1  # whitened slope of the Laplace determinant that costs acceptance
_ADDED = 0.05  # of three, what the accelerometers add to the gyros' knowledge of the rate
_WIDEST = np.deg2rad(3e6) ** 2  # (rad/s²)², ω̇ that no hand exceeds
_CLOSE = 0.05  # Newton decrement at which a point counts as the mode


@dataclass(frozen=True)
class Frame:
    """mode (d,); root (d, d) lower L; value: the log posterior at the mode; posterior: with the
    conditional starts at the mode and the cheapest gradient that is good there."""

    posterior: ArrayPosterior
    mode: Array
    root: Array
    value: float

    @property
    def covariance(self) -> Array:
        return self.root @ self.root.T

    def place(self, z: Array) -> Array:
        """x (…, d) of z."""
        return np.asarray(self.mode + z @ self.root.T)


def start_prior(data: ArrayData, prior: ArrayPrior) -> ArrayPrior:
    """The prior with its motion scale from the data at the drawing: mean square ω̇, under a prior
    that only closes what IMUs on one line leave open."""
    flat = replace(
        prior, motion="learned", motion_scale=_WIDEST, exponent=0.5, estimate_noise=False
    )
    x = flat.mean_vector[None]
    given, _ = conditionals(data, flat, x)
    w = np.asarray(data.rate.T)[None]
    spin = given.gain @ (given.torque - cross(w, given.inertia @ w))
    return replace(prior, motion_scale=float(np.mean(spin * spin)))


def laplace_frame(data: ArrayData, prior: ArrayPrior) -> Frame:
    """Mode and Hessian. Raises NotConverged when no mode is found."""
    x, root = prior.mean_vector, np.diag(prior.sd_vector) * 0.01
    few = data
    if data.samples > 2 * _FEW:
        few = data.take(np.linspace(0, data.samples - 1, _FEW).astype(np.intp))
        x, root = _climb(_posterior(few, prior, x), x, root)
        root = root * np.sqrt(few.samples / data.samples)
    posterior = _posterior(data, prior, x)
    x, root = _climb(posterior, x, root, fresh=few is data)
    exact = ArrayPosterior(data, prior, posterior.mode(x[None]).rate[0])
    cheap = replace(exact, moments=False)
    value, slope = exact.value_and_gradient(x[None])
    missed = slope - cheap.value_and_gradient(x[None])[1]
    chosen = exact if float(np.abs(missed @ root).max()) > _NOTICED else cheap
    if chosen.moments and not posterior.moments:
        x, root = _climb(chosen, x, root, fresh=False)
        value = chosen.value(x[None])
    return Frame(chosen, x, _touching(chosen, x, root), float(value[0]))


def _posterior(data: ArrayData, prior: ArrayPrior, x: Array) -> ArrayPosterior:
    """With the conditional search from what x implies, and the exact gradient where the
    accelerometers say enough about the rate for it to matter."""
    mode = ArrayPosterior(data, prior, data.rate.T).mode(x[None])
    determined = np.einsum("ijt,jit->t", mode.covariance[0], data.precision)
    return ArrayPosterior(data, prior, mode.rate[0], float(np.mean(3.0 - determined)) > _ADDED)


def _climb(
    posterior: ArrayPosterior, x: Array, root: Array, *, fresh: bool = True
) -> tuple[Array, Array]:
    """Newton with a Hessian that is refreshed when it predicts badly, from x; the frame too."""
    value, gradient = (v[0] for v in posterior.value_and_gradient(x[None]))
    for k in range(_REFRESHES):
        if k or fresh:
            root = _touching(posterior, x, root)
        for _ in range(6):
            whitened = root.T @ gradient
            decrement = float(whitened @ whitened)
            if decrement < _CLOSE**2:
                return x, root
            step = root @ whitened
            # A step of several prior standard deviations is no longer within the model.
            step /= max(1.0, float(np.abs(step / posterior.prior.sd_vector).max()) / _LONGEST)
            scale = 1.0
            while scale > 1e-6:
                there = posterior.value_and_gradient((x + scale * step)[None])
                if there[0][0] >= value + 1e-4 * scale * decrement:
                    break
                scale *= 0.4
            else:
                break
            gain = float(there[0][0] - value)
            x, value, gradient = x + scale * step, there[0][0], there[1][0]
            if scale < 1.0 or gain < 0.25 * decrement or gain > 0.75 * decrement:
                break
    raise NotConverged(
        "no mode of the positions' posterior was found",
        remedy="the samples contradict each other or the board's drawing; check the mounting "
        "rotations and units, or leave out the fastest samples",
    )


def _touching(posterior: ArrayPosterior, x: Array, root: Array) -> Array:
    """Root of the inverse Hessian at x, by differences along the columns of `root`: central for
    few samples, where the posterior is skewed."""
    step = 0.1
    if posterior.data.samples < _FEW:
        d = len(x)
        points = np.concatenate([x + step * root.T, x - step * root.T])
        slopes = posterior.value_and_gradient(points)[1]
        rise = 0.5 * (slopes[:d] - slopes[d:])
    else:
        slopes = posterior.value_and_gradient(np.vstack([x, x + step * root.T]))[1]
        rise = slopes[1:] - slopes[0]
    curvature = -rise @ root / step
    values, vectors = eigen(0.5 * (curvature + curvature.T))
    floor = 1e-6 * max(float(values[-1]), 1e-300)
    whitened = vectors / np.sqrt(np.maximum(np.abs(values), floor))
    covariance = root @ whitened @ (root @ whitened).T
    # A direction that the differences make open is still held by the prior.
    sd = posterior.prior.sd_vector
    scaled = covariance / np.outer(sd, sd)
    values, vectors = eigen(0.5 * (scaled + scaled.T))
    values = np.clip(values, 1e-16, 1.5)
    return np.asarray(np.linalg.cholesky((vectors * values) @ vectors.T * np.outer(sd, sd)))
