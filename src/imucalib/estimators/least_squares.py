"""Generalised least squares with variance components: the estimator of `lab` and `actigraph`.

Alternates two exact steps until neither moves: θ and η by Levenberg-Marquardt at fixed noise, and
the noise by restricted maximum likelihood (REML) at the linearised balance.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

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
from imucalib.core.effect import Context
from imucalib.core.fit import Fit, null_directions, shrinking
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.prior import Prior
from imucalib.estimators.in_a_population import estimate_in_population
from imucalib.estimators.levenberg_marquardt import Solution, minimise
from imucalib.estimators.variance import NoiseEstimate, estimate_noise, estimate_with_prior

#: Rounds in which η settles at one θ, and the change (rad) from which the next one, its square,
#: would be rounding.
_SETTLING, _SETTLED = 6, 1e-5
#: Rounds in a row in which θ creeps without end: twelve terms of a curve took 40 s for nothing.
_PATIENCE = 3


@dataclass(frozen=True)
class State:
    """θ and η together: the point at which the balance is linearised."""

    theta: Array
    eta: Array


@dataclass(frozen=True)
class Linearised(State):
    """The same with its balance, and what whitens it."""

    at: Balanced
    white: Whitener


def fit(
    model: Model,
    observations: Observations,
    *,
    start: Array | None = None,
    noise: Noise | None = None,
    begin: Noise | None = None,
    prior: Prior | None = None,
    shrink: Array | None = None,
    rounds: int = 60,
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
    context, reference = observations.context, observations.reference
    theta = model.start(context) if start is None else start
    corrected = model.correct(theta, observations.reading, context)
    state: State = State(theta, reference.start(corrected))
    names = balance(model, state.theta, state.eta, observations).component
    current = noise or begin or Noise(1.0, names, tuple(0.01 for _ in names))
    estimate: NoiseEstimate | None = None
    converged, steps, failed = False, 0, 0
    for turn in range(rounds):
        solution = _solve(model, observations, state, current, prior, shrink, fresh=turn == 0)
        state, at, steps = solution.state, solution.state.at, steps + solution.iterations
        if prior is None:
            whole = at if shrink is None else _beside(at, model, state.theta, shrink, context)
            estimate = estimate_noise(whole, current, fixed=noise is not None)
        elif prior.noise is None:
            estimate = estimate_with_prior(at, current, prior, state.theta)
        else:
            estimate = estimate_in_population(at, prior, state.theta, fixed=noise)
        # Without settings and prior the noise is one factor, which moves nothing.
        settled = _same(estimate.noise, current) or not (names or prior is not None)
        current = estimate.noise
        failed = 0 if solution.converged else failed + 1
        if settled or failed >= _PATIENCE:
            converged = settled and solution.converged
            break
    assert estimate is not None
    found = _finish(
        model=model,
        observations=observations,
        state=state,
        at=at,
        estimate=estimate,
        converged=converged,
        steps=steps,
    )
    return replace(found, prior=prior, shrink=shrink)


def _beside(at: Balanced, model: Model, theta: Array, shrink: Array, context: Context) -> Balanced:
    """The balance with what shrinks the parameters as numbers behind the readings'."""
    rows = shrinking(shrink, model.start(context) - theta)
    settings = tuple(np.vstack([m, np.zeros((len(rows), m.shape[1]))]) for m in at.settings)
    return replace(
        at,
        residual=np.concatenate([at.residual, rows[:, 0]]),
        jacobian=np.vstack([at.jacobian, rows[:, 1:]]),
        settings=settings,
    )


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
    state = State(theta, eta)
    at = balance(model, theta, state.eta, observations)
    estimate = estimate_noise(at, noise or Noise(1.0, at.component, ()), fixed=False)
    found = _finish(
        model=model,
        observations=observations,
        state=state,
        at=at,
        estimate=estimate,
        converged=True,
        steps=0,
    )
    spread = np.zeros_like(estimate.noise_covariance)
    return replace(found, covariance=covariance, noise_covariance=spread, null_directions=())


def _solve(
    model: Model,
    observations: Observations,
    start: State,
    noise: Noise,
    prior: Prior | None,
    shrink: Array | None,
    *,
    fresh: bool,
) -> Solution[Linearised]:
    """fresh : nothing has been fitted yet, so that η may be of the start and not of the data."""
    ratio = noise.ratio
    settled = _has_settings(observations, noise)
    first_theta = model.start(observations.context)

    def at_eta(theta: Array, eta: Array) -> Linearised:
        return _with_eta(model, observations, State(theta, eta), ratio, settled)

    def linearise(state: Linearised) -> tuple[Array, Array]:
        both = state.white(np.column_stack([state.at.residual, state.at.jacobian]))
        if prior is not None:
            both = np.vstack([both, noise.factor * prior.rows(state.theta)])
        if shrink is not None:
            both = np.vstack([both, shrinking(shrink, first_theta - state.theta)])
        return both[:, 0], both[:, 1:]

    def move(state: Linearised, step: Array) -> Linearised:
        eta = state.eta
        if settled:  # where the settings go with the step, to first order
            left = state.at.residual - state.at.jacobian @ step
            eta = setting_errors(state.at, state.white, ratio, left)
        return at_eta(state.theta + step, eta)

    first = at_eta(start.theta, start.eta)
    if settled and fresh:
        # A gross error looks like a gross setting error until θ has had its say: start from
        # whichever comes out better, η settled before the first step of θ or after it.
        at = balance(model, start.theta, start.eta, observations)
        white = whitener(at.settings, ratio)
        residual, jacobian = white(at.residual), white(at.jacobian)
        scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        step = np.linalg.lstsq(jacobian / scale, residual, rcond=1e-10)[0] / scale
        with suppress(np.linalg.LinAlgError):  # the step may lead where nothing can be evaluated
            other = at_eta(start.theta + step, start.eta)
            first = min(first, other, key=lambda s: float(np.sum(linearise(s)[0] ** 2)))
    return minimise(linearise, move, first)


def _with_eta(
    model: Model, observations: Observations, state: State, ratio: tuple[float, ...], settled: bool
) -> Linearised:
    """η at its best for this θ; a flat direction moves to first order and converges along with θ.

    Large setting errors bend the linearisation: unless η is settled, the cost depends on the path
    and a step cannot be judged by it.
    """
    reference = observations.reference
    if not settled and None in reference.directions(state.eta).component:
        step = _flat_step(model, observations, state)
        state = State(state.theta, reference.move(state.eta, step))
    at = balance(model, state.theta, state.eta, observations)
    white = whitener(at.settings, ratio)
    if not settled:
        return Linearised(state.theta, state.eta, at, white)
    eta = state.eta
    for _ in range(_SETTLING):
        before, eta = eta, setting_errors(at, white, ratio, at.residual)
        if float(np.abs(eta - before).max(initial=0.0)) < _SETTLED:
            break
        at = balance(model, state.theta, eta, observations)
        white = whitener(at.settings, ratio)
    return Linearised(state.theta, eta, at, white)


def _has_settings(observations: Observations, noise: Noise) -> bool:
    """Whether a component is a setting's: those that observations share stand behind them."""
    return len(noise.component) > len(observations.shared)


def _flat_step(model: Model, observations: Observations, state: State) -> Array:
    """Gauss-Newton step along the flat directions of every observation, at fixed θ."""
    reference = observations.reference
    predicted = model.predict(state.theta, reference.truth(state.eta), observations.context)
    directions = reference.directions(state.eta)
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
    state: State,
    at: Balanced,
    estimate: NoiseEstimate,
    converged: bool,
    steps: int,
) -> Fit:
    parameters = model.parameters(observations.context)
    return Fit(
        model=model,
        parameters=parameters,
        theta=state.theta,
        covariance=estimate.covariance,
        eta=state.eta,
        noise=estimate.noise,
        noise_covariance=estimate.noise_covariance,
        slope=estimate.slope,
        at=at,
        observations=observations,
        chi2=estimate.chi2,
        dof=estimate.dof,
        log_likelihood=estimate.log_likelihood,
        null_directions=null_directions(estimate.white_jacobian, parameters, estimate.noise.factor),
        converged=converged,
        iterations=steps,
    )
