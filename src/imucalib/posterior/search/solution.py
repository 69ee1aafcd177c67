"""A set of components as a model: its parameters by linear algebra, and as a fit.

Given a noise and the sizes, the parameters are normal; what is returned is their mean over the
noises, at the linearisation of the problem. The final fit solves the equations as they are, with
the sizes as priors of what the set adds (`Fit.shrink`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.search.gram import Block, Grams
from imucalib.posterior.search.problem import Contest, Problem
from imucalib.posterior.search.space import Hypothesis, Pick, blocks_of

#: Of its typical size, what is left to a parameter that a member does not free.
_HELD = 1e-6


@dataclass(frozen=True)
class Solved:
    """A model with its θ (p,), their covariance (p, p) and, over the noise factor, the sd of each
    parameter before the data: infinite for the base model's."""

    model: Model
    theta: Array
    covariance: Array
    shrink: Array


def solve(problem: Problem, grams: Grams, hypothesis: Hypothesis) -> Solved:
    """The model of a set and its parameters, at the mean over the noises of these Grams."""
    picks = [(problem.choices[p.choice], p.size) for p in hypothesis.picks]
    mean, covariance = moments(problem, grams, blocks_of(problem.choices, hypothesis.picks))
    context = problem.fit.observations.context
    effects = {e.name: e for c, _ in picks for e, _, _ in c.member.effects}
    model = Model((*problem.model.effects, *effects.values()))
    # θ is linear in the numbers of the columns: two members may share a parameter.
    slices, theta = model.slices(context), model.start(context)
    turn, spread = np.zeros((theta.size, mean.size)), np.zeros(theta.size)
    for name, part in problem.model.slices(context).items():
        theta[slices[name]] = problem.start[part]
        turn[slices[name], part] = np.eye(part.stop - part.start)
    at = problem.base
    for choice, size in picks:
        for effect, own, scale in choice.member.effects:
            rows = slices[effect.name].start + own
            turn[rows, at + np.arange(own.size)] = scale
            spread[rows] = np.hypot(spread[rows], size * scale)
            at += own.size
    shrink, still = np.full(theta.size, np.inf), np.zeros(theta.size)
    for effect in effects.values():
        part = slices[effect.name]
        held = _HELD * np.array([p.typical for p in effect.parameters(context)])
        shrink[part] = np.maximum(spread[part], held)
        still[part] = np.where(spread[part] > 0.0, 0.0, held)
    whole = turn @ covariance @ turn.T + np.diag(still**2)
    return Solved(model, theta + turn @ mean, whole, shrink)


def moments(problem: Contest, grams: Grams, blocks: Sequence[Block]) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k) of the numbers of base and blocks over the noises."""
    weight, each, spread = _conditional(problem, grams, blocks)
    mean = weight @ each
    away = each - mean
    between = (away * weight[:, None]).T @ away
    return mean, np.asarray(np.einsum("e,ekl->kl", weight, spread) + between)


def change(problem: Problem, grams: Grams, hypothesis: Hypothesis) -> float:
    """m/s², rms over the observations: by how much the model of a set and the base model differ in
    what they make of a reading, at the mean over the noises."""
    blocks = blocks_of(problem.choices, hypothesis.picks)
    numbers = moments(problem, grams, blocks)[0]
    numbers[: problem.base] -= moments(problem, grams, ())[0]
    used = np.concatenate([np.arange(problem.base), *(c for c, _ in blocks)])
    unit = problem.fit.at.unit
    moved = unit * (problem.columns[: unit.size, used] @ numbers)
    return float(np.sqrt(moved @ moved / problem.fit.observations.n))


def noises_of(problem: Problem, grams: Grams, picks: Sequence[Pick]) -> Array:
    """(E,) weight of each noise beside a set."""
    return _conditional(problem, grams, blocks_of(problem.choices, picks))[0]


def _conditional(
    problem: Contest, grams: Grams, blocks: Sequence[Block]
) -> tuple[Array, Array, Array]:
    """(E,) weight of each noise beside blocks of columns, (E, k) the numbers of base and blocks
    there, and their covariance (E, k, k)."""
    every = ((np.arange(problem.base), np.inf), *blocks)
    columns = np.concatenate([at for at, _ in every])
    prior = np.concatenate([np.full(at.size, size**-2.0) for at, size in every])
    rows = grams.rows(columns)
    inner = rows[:, :, columns] + np.diag(prior)
    along = rows[:, :, -1]
    inverse = np.linalg.inv(inner)
    each = (inverse @ along[..., None])[..., 0]
    left = np.maximum(grams.power - np.einsum("ek,ek->e", along, each), 1e-9)
    dof = grams.numbers - problem.base
    logs = grams.log_weight - 0.5 * np.linalg.slogdet(inner)[1] + grams.log_noise(left, dof)
    weight = np.exp(logs - logs.max())
    return weight / weight.sum(), each, inverse * (left / dof)[:, None, None]


def fit_of(problem: Problem, found: Solved, data: Observations) -> Fit:
    """The model fitted to observations, with its sizes as priors, from where it is. A noise that
    they share beyond those of the problem begins as large as that of a reading."""
    adds = found.model.names != problem.model.names
    begin, fit = problem.fit.noise, problem.fit
    more = tuple(noise.name for noise in data.shared[len(fit.observations.shared) :])
    size = begin.factor * float(np.median(fit.at.sigma))
    begin = Noise(begin.factor, (*begin.component, *more), (*begin.sd, *(size for _ in more)))
    return fit_model(
        found.model,
        data,
        start=found.theta,
        begin=begin,
        shrink=found.shrink if adds else None,
    )
