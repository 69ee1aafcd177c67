"""Noise and covariance of one of a kind: θ and the noise have the priors that others of it tell.

With θ ~ N(m, Q) a linearised balance r = J (θ - θ₀) + noise is normal about J (m - θ₀) with
V + J Q Jᵀ, V = s² I + Σ sd_c² N_c N_cᵀ. The logs of s and sd_c have normal priors; the estimate is
their maximum a posteriori (empirical Bayes; Laird and Ware 1982, section 3).
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, whitener
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.core.prior import Prior
from imucalib.estimators.variance import NoiseEstimate

#: Standard deviations of the prior's logs within which the noise is looked for, and logs at most.
_REACH, _WIDEST = 6.0, 14.0
#: Share of a prior variance that the data must take away to have said something.
_HEARD = 0.05


def estimate_in_population(
    at: Balanced, prior: Prior, theta: Array, *, fixed: Noise | None = None
) -> NoiseEstimate:
    """At a balance that is linearised at θ; with `fixed` only the covariance is computed."""
    assert prior.noise is not None
    away = at.residual + at.jacobian @ (theta - prior.mean)
    if fixed is None:
        logs = _search(at, prior, away)
    else:
        logs = np.log(np.maximum([fixed.factor, *fixed.sd], 1e-300))
    own = _derivatives(at, logs)
    inverse, covariance, weighted = _conditional(at, prior, 0.5 * np.sum(own, axis=0))
    gain = covariance @ weighted
    value, _, information = _posterior(at, prior, away, logs)
    spread = np.zeros_like(information) if fixed is not None else np.linalg.inv(information)
    noise = Noise(float(np.exp(logs[0])), at.component, tuple(np.exp(logs[1:]).tolist()))
    used = float(np.trace(gain @ at.jacobian))
    white = whitener(at.settings, noise.ratio)
    return NoiseEstimate(
        noise=noise,
        covariance=covariance,
        slope=np.array([gain @ d @ gain.T for d in own]),
        noise_covariance=np.asarray(spread, np.float64),
        chi2=float(at.residual @ inverse @ at.residual) * noise.factor**2,
        dof=max(0, round(at.residual.size - used)),
        log_likelihood=-value,
        white_jacobian=np.vstack([white(at.jacobian), noise.factor * prior.root]),
    )


def kind_chance(fit: Fit) -> float:
    """Chance that one of the kind is as far from its mean: χ² of d' (Q - C)⁻¹ d with d = θ - m,
    whose covariance before the data are seen is Q - C, along what the data say something of."""
    from scipy.special import chdtrc

    prior = fit.prior
    assert prior is not None
    deviation = prior.root @ (fit.theta - prior.mean)
    expected = np.eye(deviation.size) - prior.root @ fit.covariance @ prior.root.T
    values, vectors = eigen(0.5 * (expected + expected.T))
    heard = values > _HEARD
    along = vectors[:, heard].T @ deviation
    return float(chdtrc(max(int(heard.sum()), 1), float(np.sum(along**2 / values[heard]))))


def _derivatives(at: Balanced, logs: Array) -> list[Array]:
    """∂V / ∂log of each noise; half their sum is V."""
    values = np.exp(2.0 * logs)
    derivative = [2.0 * values[0] * np.eye(at.residual.size)]
    return derivative + [2.0 * v * m @ m.T for v, m in zip(values[1:], at.settings, strict=True)]


def _conditional(at: Balanced, prior: Prior, whole: Array) -> tuple[Array, Array, Array]:
    """V⁻¹, the covariance (Q⁻¹ + J'V⁻¹J)⁻¹ of θ, and J'V⁻¹, of V (N, N)."""
    inverse: Array = np.asarray(np.linalg.inv(whole), np.float64)
    weighted = at.jacobian.T @ inverse
    information = prior.root.T @ prior.root + weighted @ at.jacobian
    return inverse, np.asarray(np.linalg.inv(information), np.float64), weighted


def _posterior(at: Balanced, prior: Prior, away: Array, logs: Array) -> tuple[float, Array, Array]:
    """Minus the log posterior of the noise's logs, its slope, and its expected curvature.

    V + J Q Jᵀ is never formed: beside a prior that says little, V would be rounding in it.
    """
    assert prior.noise is not None
    own = _derivatives(at, logs)
    whole = 0.5 * np.sum(own, axis=0)
    inverse, covariance, weighted = _conditional(at, prior, whole)
    shift = covariance @ (weighted @ away)
    rest, pulled = away - at.jacobian @ shift, prior.root @ shift
    u = inverse @ rest
    deviation = (logs - prior.noise[:, 0]) / prior.noise[:, 1]
    log_det = np.linalg.slogdet(whole)[1] - np.linalg.slogdet(covariance)[1]
    value = 0.5 * float(log_det + rest @ u + pulled @ pulled + deviation @ deviation)
    reduced = inverse - weighted.T @ covariance @ weighted
    products = [reduced @ d for d in own]
    slope = [
        0.5 * (float(np.trace(p)) - float(u @ d @ u)) for p, d in zip(products, own, strict=True)
    ]
    curvature = 0.5 * np.array([[float(np.sum(a * b.T)) for b in products] for a in products])
    slopes = np.array(slope) + deviation / prior.noise[:, 1]
    return value, slopes, curvature + np.diag(prior.noise[:, 1] ** -2.0)


def _search(at: Balanced, prior: Prior, away: Array) -> Array:
    from scipy.optimize import minimize

    noise = prior.noise
    assert noise is not None
    bounds = [(m - min(_REACH * sd, _WIDEST), m + min(_REACH * sd, _WIDEST)) for m, sd in noise]
    found = minimize(
        lambda logs: _posterior(at, prior, away, logs)[:2],
        noise[:, 0],
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"ftol": 1e-13, "gtol": 1e-8, "maxiter": 200},
    )
    return np.asarray(found.x)
