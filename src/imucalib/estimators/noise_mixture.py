"""A fit's parameters with the noise integrated out: one normal a likely noise, weighed.

With few rows the noise of the readings and the scatter of the settings are known to a factor only,
and parameters and their covariance move with them. Points of the noise's posterior are drawn from a
Student t about its mode in the logs, and weighed by posterior over density (importance sampling;
Geweke 1989). Given the noise, θ is normal: generalised least squares at the fit's balance.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import balance, setting_errors, whitener
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit, NoiseMixture
from imucalib.estimators.variance import RATIO

#: Numbers of a balance up to which the noise is integrated out: beyond, its estimate is known to a
#: tenth, and Student's t with Satterthwaite's degrees of freedom is the same.
_MOST = 240
#: Points that are drawn and the share kept, at a time; degrees of freedom of what draws them.
_DRAWN, _KEPT, _CHUNK, _TAILS = 512, 128, 64, 4.0
#: Of the logs, for slopes by differences; standard deviations of the prior within which they lie.
_STEP, _SPREADS = 1e-2, 6.0
#: Balances that are linearised anew at the mean.
_ROUNDS = 2


def integrate_noise(fit: Fit) -> Fit:
    """The fit at its mean over all noise that the data and the prior allow, with the mixture's
    covariance and intervals; as it is without a prior, where nothing was estimated, and with many
    rows."""
    size = fit.at.residual.size
    known = fit.observations.noise_prior is not None and fit.prior is None
    if not known or size > _MOST or not fit.noise_covariance.any():
        return fit
    draws, weight = _draw_points(*_locate_mode(_Target(fit), fit))
    for _ in range(_ROUNDS):
        fit = _move(fit, weight @ _Target(fit).evaluate(draws)[1])
    _, shift, covariance = _Target(fit).evaluate(draws)
    mean = weight @ shift
    apart = shift - mean
    whole = np.einsum("m,mpq->pq", weight, covariance) + (apart * weight[:, None]).T @ apart
    logs = draws - weight @ draws
    mixture = NoiseMixture(np.sqrt(weight @ logs**2), weight, shift, covariance)
    return replace(fit, covariance=whole + np.outer(mean, mean), mixture=mixture)


def _move(fit: Fit, step: Array) -> Fit:
    """The fit at θ + step, its settings where they are best there."""
    model, data, at = fit.model, fit.observations, fit.at
    theta, ratio = fit.theta + step, fit.noise.ratio
    misfit = at.residual - at.jacobian @ step
    eta = setting_errors(at, whitener(at.settings, ratio), ratio, misfit) if at.free else fit.eta
    return replace(fit, theta=theta, eta=eta, at=balance(model, theta, eta, data))


class _Target:
    """The posterior of the logs of factor and sds at one balance, for many points at once."""

    def __init__(self, fit: Fit) -> None:
        at, prior = fit.at, fit.at.prior
        assert prior is not None
        self._at, self._prior_of = at, prior
        self._grams = np.array([np.eye(at.residual.size), *(m @ m.T for m in at.settings)])
        self._data = np.column_stack([at.jacobian, at.residual])
        reach = np.array([max(float(np.abs(m).max()), 1e-300) for m in at.settings])
        self._ratio = np.log(RATIO[0] / reach), np.log(RATIO[1] / reach)
        start = np.array([p.start for p in fit.parameters])
        self._precision, self._off = fit.known_sd**-2.0, start - fit.theta

    def within(self, logs: Array) -> Array:
        """Logs (m, 1 + c) with sds that differ from nothing and from the noise."""
        widest = _SPREADS * self._prior_of.spread
        first = np.clip(logs[:, :1], -widest, widest)
        low, high = (first + edge for edge in self._ratio)
        return np.column_stack([first, np.clip(logs[:, 1:], low, high)])

    def evaluate(self, logs: Array) -> tuple[Array, Array, Array]:
        """(m,) log density of logs (m, 1 + c), up to a constant; (m, p) θ at each noise less the
        fit's, and its covariance (m, p, p)."""
        logs = self.within(logs)
        found = [self._some(logs[a : a + _CHUNK]) for a in range(0, len(logs), _CHUNK)]
        density, shift, covariance = map(np.concatenate, zip(*found, strict=True))
        return density, shift, covariance

    def _some(self, logs: Array) -> tuple[Array, Array, Array]:
        whole = np.einsum("mc,cij->mij", np.exp(2.0 * logs), self._grams)
        lower = np.linalg.cholesky(whole)
        white = np.linalg.solve(lower, np.broadcast_to(self._data, (len(logs), *self._data.shape)))
        jacobian, residual = white[..., :-1], white[..., -1]
        information = jacobian.swapaxes(1, 2) @ jacobian + np.diag(self._precision)
        size = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
        scaled = information / (size[:, :, None] * size[:, None, :])
        inverse = np.linalg.inv(scaled)
        covariance = inverse / (size[:, :, None] * size[:, None, :])
        slope = np.einsum("mni,mn->mi", jacobian, residual) + self._precision * self._off
        shift = np.einsum("mij,mj->mi", covariance, slope)
        power = np.sum(residual**2, axis=1) - np.einsum("mi,mi->m", slope, shift)
        log_det = 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        log_det += np.linalg.slogdet(scaled)[1] + 2.0 * np.log(size).sum(axis=1)
        return -0.5 * (log_det + power) + self._prior(logs), shift, covariance

    def _prior(self, logs: Array) -> Array:
        """Log-normal factor, half-Cauchy settings, flat sd of what has no prior; all by logs."""
        prior, free = self._prior_of, self._at.free
        square = np.exp(2.0 * logs[:, 1 : 1 + free]) / prior.setting**2
        found = -0.5 * (logs[:, 0] / prior.spread) ** 2 - np.log1p(square).sum(axis=1)
        return np.asarray(found + logs[:, 1:].sum(axis=1))


def _locate_mode(target: _Target, fit: Fit) -> tuple[_Target, Array, Array]:
    """The target, its mode in the logs, and the covariance of the normal that touches it."""
    from scipy.optimize import minimize

    start = np.log(np.maximum([fit.noise.factor, *fit.noise.sd], 1e-300))
    start = target.within(start[None])[0]
    steps = _STEP * np.eye(start.size)

    def slope(x: Array) -> tuple[float, Array]:
        every, _, _ = target.evaluate(np.concatenate([x[None], x + steps, x - steps]))
        up, down = every[1 : 1 + x.size], every[1 + x.size :]
        return -float(every[0]), -(up - down) / (2.0 * _STEP)

    found = np.asarray(minimize(slope, start, jac=True, method="L-BFGS-B").x)
    rows = np.array([slope(found + s)[1] - slope(found - s)[1] for s in steps]) / (2.0 * _STEP)
    values, vectors = eigen(0.5 * (rows + rows.T))
    spread = (vectors / np.clip(values, 0.1, None)) @ vectors.T
    return target, found, spread


def _draw_points(target: _Target, at: Array, spread: Array) -> tuple[Array, Array]:
    """Points of the logs and their weights, a few that stand for all that were drawn."""
    rng = np.random.default_rng(0)
    lower = np.linalg.cholesky(spread)
    z = (
        rng.normal(size=(_DRAWN, at.size))
        / np.sqrt(rng.chisquare(_TAILS, _DRAWN) / _TAILS)[:, None]
    )
    draws = at + z @ lower.T
    density = -0.5 * (_TAILS + at.size) * np.log1p(np.sum(z**2, axis=1) / _TAILS)
    logs = target.evaluate(draws)[0] - density
    weight = np.exp(logs - logs.max())
    total = np.cumsum(weight) / weight.sum()
    chosen = np.searchsorted(total, (np.arange(_KEPT) + 0.5) / _KEPT)
    rows, count = np.unique(chosen, return_counts=True)
    return draws[rows], count / _KEPT
