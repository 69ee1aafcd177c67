"""Variance components by restricted maximum likelihood (REML).

V = s² I + Σ sd_c² N_c N_cᵀ in units of the declared noise. REML loses no degrees of freedom to the
fitted parameters, which matters when 12 parameters face 12 settings (Patterson and Thompson 1971).
Where something is known of the noise (`NoisePrior`), its posterior takes the likelihood's place:
the densities of log s and of sd_c, so that a component that is not needed may still vanish.

Of one of a kind θ and the noise have the priors that others of it tell. With θ ~ N(m, Q) a balance
r = J (θ - θ₀) + noise that is linearised is normal about J (m - θ₀) with V + J Q Jᵀ. The logs of s
and sd_c have normal priors; the estimate is their maximum a posteriori (empirical Bayes; Laird and
Ware 1982, section 3).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Balanced, Noise, whitener
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.core.observations import NoisePrior
from imucalib.core.prior import Prior
from imucalib.core.restricted import Restricted, restrict

#: Search range of a setting's standard deviation, as its largest effect on a reading in units of
#: the readings' noise. Below `_VANISHED` the component counts as zero.
RATIO = (1e-3, 1e5)
_VANISHED = 1e-2
#: The same of noise that has a number for every reading, as what neighbours share and the excess of
#: an axis: it can stand in for a reading's own, and nothing would be left of that, in whose units
#: all else is.
INSTEAD = 30.0
#: What the prior of the noise factor weighs, in observations.
_PRIOR_DOF = 4.0
#: Standard deviations of a kind's logs within which the noise is looked for, and logs at most.
_REACH, _WIDEST = 6.0, 14.0
#: Share of a prior variance that the data must take away to have said something.
_HEARD = 0.05


@dataclass(frozen=True)
class NoiseEstimate:
    """The noise and all that follows from it at one linearised balance.

    covariance : (p, p) of θ; slope : (c, p, p) its derivative by each log noise parameter
    noise_covariance : (c, c) of the log noise parameters, zero where the noise was given
    chi2 : weighted sum of squares with the settings' covariance, at factor 1; dof : N - p
    """

    noise: Noise
    covariance: Array
    slope: Array
    noise_covariance: Array
    chi2: float
    dof: int
    log_likelihood: float
    white_jacobian: Array


def estimate_noise(at: Balanced, start: Noise, *, fixed: bool) -> NoiseEstimate:
    """REML estimate from a balance; with `fixed`, only evaluate at `start`."""
    if not at.settings:
        return _independent(at, start, fixed=fixed)
    noise = start if fixed else _search(at, start)
    return _evaluate(at, noise, fixed=fixed)


def _independent(at: Balanced, start: Noise, *, fixed: bool) -> NoiseEstimate:
    """No settings: one factor, in closed form, without any N by N matrix."""
    size, p = at.jacobian.shape
    q, r = np.linalg.qr(at.jacobian)
    rest = at.residual - q @ (q.T @ at.residual)
    chi2, dof = float(rest @ rest), size - p
    factor = start.factor if fixed else _factor_at(chi2, dof, np.zeros(0), at)
    inverse = np.linalg.pinv(r.T @ r, rcond=1e-14)
    covariance = factor**2 * inverse
    log_det = float(np.log(np.maximum(np.abs(np.diag(r)), 1e-300)).sum())
    likelihood = -0.5 * chi2 / factor**2 - dof * np.log(factor) - log_det
    known = at.prior.spread**-2 if at.prior else 0.0
    spread = 0.0 if fixed else 1.0 / (2.0 * max(dof, 1) + known)
    return NoiseEstimate(
        noise=Noise(factor),
        covariance=covariance,
        slope=2.0 * covariance[None],
        noise_covariance=np.array([[spread]]),
        chi2=chi2,
        dof=dof,
        log_likelihood=float(likelihood),
        white_jacobian=at.jacobian,
    )


def estimate_with_prior(at: Balanced, start: Noise, prior: Prior, theta: Array) -> NoiseEstimate:
    """The factor and the covariance where the parameters have a prior. The factor has one too, of
    `_PRIOR_DOF` observations at 1, so that it exists for a single one. Its estimate is the fixed
    point of the evidence: parameters cost degrees of freedom as far as the data determine them
    (MacKay 1992). Only for balances without settings.
    """
    assert not at.settings
    information, precision = at.jacobian.T @ at.jacobian, prior.root.T @ prior.root
    chi2, size = float(at.residual @ at.residual), at.residual.size
    square = start.factor**2
    for _ in range(100):
        covariance: Array = np.asarray(np.linalg.inv(information / square + precision), np.float64)
        used = float(np.sum(information * covariance)) / square
        dof = _PRIOR_DOF + size - used
        before, square = square, (_PRIOR_DOF + chi2) / dof
        if abs(square - before) <= 1e-10 * before:
            break
    factor = float(np.sqrt(square))
    covariance = np.asarray(np.linalg.inv(information / square + precision), np.float64)
    log_det = -float(np.linalg.slogdet(precision @ covariance)[1])
    away = prior.rows(theta)[:, 0]
    likelihood = -0.5 * (chi2 / square + float(away @ away) + log_det)
    return NoiseEstimate(
        noise=Noise(factor),
        covariance=covariance,
        slope=2.0 / square * (covariance @ information @ covariance)[None],
        noise_covariance=np.array([[0.5 / dof]]),
        chi2=chi2,
        dof=max(0, round(size - used)),
        log_likelihood=likelihood - size * float(np.log(factor)),
        white_jacobian=at.jacobian,
    )


def _search(at: Balanced, start: Noise) -> Noise:
    """Maximise over the log ratios sd_c / s, with s in closed form at each."""
    from scipy.optimize import minimize

    reach = np.array([max(float(np.abs(m).max()), 1e-300) for m in at.settings])
    low, high = np.log(RATIO[0] / reach), np.log(RATIO[1] / reach)
    space = restrict(at.jacobian, at.settings)
    for c, matrix in enumerate(at.settings):
        if c >= at.free and 3 * matrix.shape[1] >= at.residual.size:
            high[c] = np.log(INSTEAD / reach[c])
    data, dof = space.turn(at.residual), at.residual.size - at.jacobian.shape[1]

    def objective(logs: Array) -> tuple[float, Array]:
        return _profile(space, data, dof, np.exp(logs), at)

    first = np.clip(np.log(np.maximum(start.sd, 1e-12)) - np.log(start.factor), low, high)

    def descend(first: Array) -> Any:
        return minimize(
            objective,
            first,
            jac=True,
            method="L-BFGS-B",
            bounds=list(zip(low, high, strict=True)),
            options={"ftol": 1e-13, "gtol": 1e-7, "maxiter": 200},
        )

    found = descend(first)
    zero = np.log(_VANISHED / reach)
    if np.any(found.x < zero):
        # The likelihood is flat near zero: a long first step can be stranded there.
        found = min(found, descend(-np.log(reach)), key=lambda result: float(result.fun))
    ratio = np.where(found.x > zero, np.exp(found.x), 0.0)
    covariance = space.at(ratio)
    power = covariance.power(covariance.solve(data))
    factor = _factor_at(power, dof, ratio, at)
    return Noise(factor, at.component, tuple(float(r) * factor for r in ratio))


def _factor_at(power: float, dof: int, ratio: Array, at: Balanced) -> float:
    """The factor at its best for ratios sd_c / s."""
    if at.prior is None:
        return float(np.sqrt(max(power / max(dof, 1), 1e-30)))
    log, own = 0.0, ratio[: at.free]
    for _ in range(100):
        share = _cauchy_slopes(np.exp(log) * own, at.prior)
        some = power * np.exp(-2.0 * log)
        slope = some - dof - log / at.prior.spread**2 - share.sum()
        bend = 2.0 * some + at.prior.spread**-2 + float(np.sum(share * (2.0 - share)))
        step = float(np.clip(slope / bend, -2.0, 2.0))
        log += step
        if abs(step) < 1e-12:
            break
    return float(np.exp(log))


def _cauchy_slopes(sd: Array, prior: NoisePrior) -> Array:
    """Slopes of log(1 + sd² / setting²), minus the log of the half-Cauchy's density, by log sd."""
    square = (sd / prior.setting) ** 2
    return np.asarray(2.0 * square / (1.0 + square))


def _profile(
    space: Restricted, data: Array, dof: int, ratio: Array, at: Balanced
) -> tuple[float, Array]:
    """Minus the restricted log likelihood or posterior with s at its best, and its slopes by the
    log ratios."""
    covariance = space.at(ratio)
    rest, projection = solved = covariance.solve(data)
    power = max(covariance.power(solved), 1e-300)
    # tr V⁻¹ U_c U_c' = q_c - tr of the capacity's inverse, and U' V⁻¹ y is what U takes.
    square = _factor_at(power, dof, ratio, at) ** 2
    own = 1.0 - covariance.inside - projection**2 / square
    slope: Array = np.bincount(space.owner, own, minlength=ratio.size).astype(np.float64)
    if space.wide >= 0:
        each = ratio[space.wide] ** 2 * space.spread
        slope[space.wide] = float(each @ covariance.own) - float(each @ rest**2) / square
    value = 0.5 * (covariance.log_det + dof * float(np.log(square)) + power / square)
    if at.prior is not None:
        sd = float(np.sqrt(square)) * ratio[: at.free]
        value += 0.5 * (0.5 * float(np.log(square)) / at.prior.spread) ** 2
        value += float(np.log1p((sd / at.prior.setting) ** 2).sum())
        slope[: at.free] += _cauchy_slopes(sd, at.prior)
    return value, slope


def _evaluate(at: Balanced, noise: Noise, *, fixed: bool) -> NoiseEstimate:
    """Nothing here has N by N numbers but the whitener's blocks."""
    square, white = noise.factor**2, whitener(at.settings, noise.ratio)
    weighted = white.weigh(at.jacobian) / square
    information = at.jacobian.T @ weighted
    covariance = np.asarray(np.linalg.pinv(information, rcond=1e-14), np.float64)

    def project(data: Array) -> Array:
        """(N, D) of P data: V⁻¹ without what the parameters take."""
        return white.weigh(data) / square - weighted @ (covariance @ (weighted.T @ data))

    # dV / dlog s = 2 s², dV / dlog sd_c = 2 sd_c² N_c N_c'.
    py, gain = project(at.residual[:, None])[:, 0], weighted @ covariance
    sized = [sd * matrix for sd, matrix in zip(noise.sd, at.settings, strict=True)]
    directed = np.column_stack([2.0 * square * py, *(2.0 * m @ (m.T @ py) for m in sized)])
    through = [noise.factor * gain, *(m.T @ gain for m in sized)]
    # A component that is zero: nothing to learn about it, nothing to propagate.
    alive = np.array([True] + [sd > 0.0 for sd in noise.sd])
    spread = np.zeros((alive.size, alive.size))
    if not fixed:
        about = 0.5 * directed.T @ project(directed)
        if at.prior is not None:
            share = _cauchy_slopes(np.array(noise.sd[: at.free]), at.prior)
            known = [at.prior.spread**-2, *(share * (2.0 - share))]
            about[np.diag_indices(len(known))] += known
        spread[np.ix_(alive, alive)] = np.linalg.pinv(about[np.ix_(alive, alive)])
    quadratic = float(at.residual @ py)
    log_det = white.log_det + at.residual.size * float(np.log(square))
    log_det += float(np.linalg.slogdet(information)[1])
    return NoiseEstimate(
        noise=noise,
        covariance=covariance,
        slope=np.array([2.0 * (part.T @ part) for part in through]),
        noise_covariance=spread,
        chi2=quadratic * square,
        dof=at.residual.size - at.jacobian.shape[1],
        log_likelihood=-0.5 * (log_det + quadratic),
        white_jacobian=white(at.jacobian),
    )


def estimate_in_population(
    at: Balanced, prior: Prior, theta: Array, *, fixed: Noise | None = None
) -> NoiseEstimate:
    """At a balance that is linearised at θ; with `fixed` only the covariance is computed."""
    assert prior.noise is not None
    away = at.residual + at.jacobian @ (theta - prior.mean)
    if fixed is None:
        logs = _search_in_population(at, prior, away)
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


def _search_in_population(at: Balanced, prior: Prior, away: Array) -> Array:
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
