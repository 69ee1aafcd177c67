"""Generalised least squares with variance components: the estimator of `lab` and `actigraph`.

Alternates two exact steps until neither moves: θ and η by Levenberg-Marquardt at fixed noise, and
the noise by restricted maximum likelihood (REML) at the linearised balance.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import (
    Balanced,
    Noise,
    Whitener,
    balance,
    setting_errors,
    whitener,
)
from imucalib.core.fit import Fit, null_directions, shrink_rows
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior
from imucalib.estimators.levenberg_marquardt import Solution, minimise
from imucalib.estimators.variance import (
    NoiseEstimate,
    estimate_in_population,
    estimate_noise,
    estimate_with_prior,
)

#: Rounds in which η settles at one θ, and the change (rad) from which the next one, its square,
#: would be rounding.
_SETTLING, _SETTLED = 6, 1e-5
#: Rounds of both steps.
_ROUNDS = 60
#: Rounds in a row in which θ creeps without end: twelve terms of a curve took 40 s for nothing.
_PATIENCE = 3


def fit(
    model: Model,
    observations: Observations,
    *,
    start: Array | None = None,
    noise: Noise | None = None,
    begin: Noise | None = None,
    prior: Prior | None = None,
    shrink: Array | None = None,
) -> Fit:
    """Fit θ, η and, unless `noise` is given, the noise.

    start : θ to start from; the effects' own starting values by default
    noise : held fixed when given (held-out refits); otherwise estimated by REML, from `begin`
    prior : of θ: the maximum a posteriori, which exists for any number of observations; one that
        knows nothing of the noise serves observations without settings only
    shrink : (p,) standard deviations of parameters about their start over the noise factor,
        infinite where they are free: rows beside the readings, so that the noise is estimated as
        without
    A Fit whose `converged` is False must not be reported as a calibration.
    """
    reference, first = observations.reference, model.start(observations.context)
    theta = first if start is None else start
    eta = reference.start(model.correct(theta, observations.reading, observations.context))
    names = balance(model, theta, eta, observations).component
    current = noise or begin or Noise(1.0, names, tuple(0.01 for _ in names))
    estimate: NoiseEstimate | None = None
    converged, failed = False, 0
    for turn in range(_ROUNDS):
        problem = _Problem(model, observations, current, prior, shrink)
        solution = problem.solve(theta, eta, fresh=turn == 0)
        theta, eta, at = solution.state.theta, solution.state.eta, solution.state.at
        if prior is None:
            whole = at if shrink is None else _add_rows(at, shrink_rows(shrink, first - theta))
            estimate = estimate_noise(whole, current, fixed=noise is not None)
        elif prior.noise is None:
            estimate = estimate_with_prior(at, current, prior, theta)
        else:
            estimate = estimate_in_population(at, prior, theta, fixed=noise)
        # Without settings and prior the noise is one factor, which moves nothing.
        settled = _same(estimate.noise, current) or not (names or prior is not None)
        current = estimate.noise
        failed = 0 if solution.converged else failed + 1
        if settled or failed >= _PATIENCE:
            converged = settled and solution.converged
            break
    assert estimate is not None
    found = _finish(model, observations, theta, eta, at, estimate)
    return replace(found, converged=converged, prior=prior, shrink=shrink)


def evaluate(
    model: Model,
    observations: Observations,
    theta: Array,
    covariance: Array,
    noise: Noise | None = None,
    eta: Array | None = None,
) -> Fit:
    """A Fit at a θ that another estimator found, with that estimator's covariance; eta : the free
    directions there, those of the readings by default."""
    if eta is None:
        eta = observations.reference.start(observations.reading)
    at = balance(model, theta, eta, observations)
    estimate = estimate_noise(at, noise or Noise(1.0, at.component, ()), fixed=False)
    found = _finish(model, observations, theta, eta, at, estimate)
    spread = np.zeros_like(estimate.noise_covariance)
    return replace(found, covariance=covariance, noise_covariance=spread, null_directions=())


@dataclass(frozen=True)
class SolverPoint:
    """θ and η together, the balance that is linearised there, and what whitens it."""

    theta: Array
    eta: Array
    at: Balanced
    white: Whitener


@dataclass(frozen=True)
class _Problem:
    """θ and η by Levenberg-Marquardt at fixed noise; fields as `fit` has them."""

    model: Model
    observations: Observations
    noise: Noise
    prior: Prior | None
    shrink: Array | None

    @cached_property
    def _first(self) -> Array:
        return self.model.start(self.observations.context)

    @property
    def _settled(self) -> bool:
        """Whether a component is a setting's: those that observations share stand behind them."""
        return len(self.noise.component) > len(self.observations.shared)

    def _point(self, theta: Array, eta: Array) -> SolverPoint:
        at = balance(self.model, theta, eta, self.observations)
        return SolverPoint(theta, eta, at, whitener(at.settings, self.noise.ratio))

    def solve(self, theta: Array, eta: Array, *, fresh: bool) -> Solution[SolverPoint]:
        """From a point; fresh : nothing has been fitted yet, so that η may be of the start and not
        of the data."""
        first = self._at(theta, eta)
        if self._settled and fresh:
            # A gross error looks like a gross setting error until θ has had its say: start from
            # whichever comes out better, η settled before the first step of θ or after it.
            point = self._point(theta, eta)
            residual, jacobian = self._linearise(point)
            scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
            step = np.linalg.lstsq(jacobian / scale, residual, rcond=1e-10)[0] / scale
            with suppress(
                np.linalg.LinAlgError
            ):  # the step may lead where nothing can be evaluated
                other = self._at(theta + step, eta)
                first = min(first, other, key=lambda p: float(np.sum(self._linearise(p)[0] ** 2)))
        return minimise(self._linearise, self._move, first)

    def _linearise(self, point: SolverPoint) -> tuple[Array, Array]:
        rows = [point.white(np.column_stack([point.at.residual, point.at.jacobian]))]
        if self.prior is not None:
            rows.append(self.noise.factor * self.prior.rows(point.theta))
        if self.shrink is not None:
            rows.append(shrink_rows(self.shrink, self._first - point.theta))
        both = np.vstack(rows)
        return both[:, 0], both[:, 1:]

    def _move(self, point: SolverPoint, step: Array) -> SolverPoint:
        eta, at = point.eta, point.at
        if self._settled:  # where the settings go with the step, to first order
            misfit = at.residual - at.jacobian @ step
            eta = setting_errors(at, point.white, self.noise.ratio, misfit)
        return self._at(point.theta + step, eta)

    def _at(self, theta: Array, eta: Array) -> SolverPoint:
        """η at its best for this θ; a flat direction moves to first order and converges along with
        θ.

        Large setting errors bend the linearisation: unless η is settled, the cost depends on the
        path and a step cannot be judged by it.
        """
        reference = self.observations.reference
        if not self._settled and None in reference.directions(eta).component:
            eta = reference.move(eta, _flat_step(self.model, self.observations, theta, eta))
        point = self._point(theta, eta)
        for _ in range(_SETTLING if self._settled else 0):
            at, before = point.at, eta
            eta = setting_errors(at, point.white, self.noise.ratio, at.residual)
            if float(np.abs(eta - before).max(initial=0.0)) < _SETTLED:
                return replace(point, eta=eta)
            point = self._point(theta, eta)
        return point


def _add_rows(at: Balanced, rows: Array) -> Balanced:
    """The balance with what shrinks the parameters, (k, 1 + p), behind the readings' numbers."""
    settings = tuple(np.vstack([m, np.zeros((len(rows), m.shape[1]))]) for m in at.settings)
    return replace(
        at,
        residual=np.concatenate([at.residual, rows[:, 0]]),
        jacobian=np.vstack([at.jacobian, rows[:, 1:]]),
        settings=settings,
    )


def _flat_step(model: Model, observations: Observations, theta: Array, eta: Array) -> Array:
    """Gauss-Newton step along the flat directions of every observation, at fixed θ."""
    reference = observations.reference
    predicted = model.predict(theta, reference.truth(eta), observations.context)
    directions = reference.directions(eta)
    n, q = directions.index.shape
    sigma = observations.sigma.reshape(n, -1)
    free = (predicted.d_truth @ directions.derivative).reshape(n, -1, q) / sigma[..., None]
    residual = (observations.reading - predicted.reading).reshape(n, -1) / sigma
    gram = free.transpose(0, 2, 1) @ free
    slope = free.transpose(0, 2, 1) @ residual[..., None]
    return np.asarray(np.linalg.solve(gram, slope).reshape(-1))


def _same(new: Noise, old: Noise) -> bool:
    a = np.array([new.factor, *new.sd])
    b = np.array([old.factor, *old.sd])
    # A component that has vanished may keep shrinking without changing anything.
    return bool(np.all(np.abs(a - b) <= 1e-5 * np.maximum(a, 1e-7)))


def _finish(
    model: Model,
    observations: Observations,
    theta: Array,
    eta: Array,
    at: Balanced,
    estimate: NoiseEstimate,
) -> Fit:
    parameters = model.parameters(observations.context)
    return Fit(
        model=model,
        parameters=parameters,
        theta=theta,
        covariance=estimate.covariance,
        eta=eta,
        noise=estimate.noise,
        noise_covariance=estimate.noise_covariance,
        slope=estimate.slope,
        at=at,
        observations=observations,
        chi2=estimate.chi2,
        dof=estimate.dof,
        log_likelihood=estimate.log_likelihood,
        null_directions=null_directions(estimate.white_jacobian, parameters, estimate.noise.factor),
        converged=True,
    )
