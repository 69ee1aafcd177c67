"""A set of components as a model: its parameters by linear algebra, and as a fit.

Given a noise and the sizes, the parameters are normal; what is returned is their mean over the
noises, at the linearisation of the problem. The final fit solves the equations as they are, with
the sizes as priors of what the set adds (`Fit.shrink`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import Noise, balance
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.starting_point import alike_rows, full_matrix_start
from imucalib.loop.candidates import Searched
from imucalib.loop.posterior.catalogue import Component, components_of, scan_of
from imucalib.loop.posterior.gram import Grams, grams_of
from imucalib.loop.posterior.noise import Terms, terms_of
from imucalib.loop.posterior.odds import FAR, HEARD
from imucalib.loop.posterior.problem import Choice, Problem, problem_of
from imucalib.loop.posterior.space import Hypothesis, Pick, Posterior, blocks_of, search

#: Probability from which on a scan is refined around what it found.
_LIKELY = 0.05


@dataclass(frozen=True)
class Explored:
    """A base fit with the posterior over what it lacks, at the noises that its leading sets give a
    say; every : Grams at all noises that the data do not exclude, be a record what it may"""

    base: Fit
    problem: Problem
    posterior: Posterior
    every: Grams


def explored(fit: Fit, asked: Searched) -> Explored:
    """The posterior at a fitted base model, scans refined where they count."""
    base = _anchored(fit)
    data = base.observations
    components = components_of(base.model, data, asked)
    terms = terms_of(base)
    first = _once(base, components, terms)
    near = near_values(first)
    if near:
        first = _once(base, refined(components, near, data, asked), terms)
    return replace(first, posterior=heard(first))


def refined(
    components: tuple[Component, ...],
    near: Mapping[str, Sequence[str]],
    data: Observations,
    asked: Searched,
) -> tuple[Component, ...]:
    """The components, scans with finer values around some."""
    own = {f"{f.name}@": f for f in asked.families}
    return tuple(
        scan_of(data, own[c.name], near[c.name]) or c if c.name in near else c for c in components
    )


def _anchored(fit: Fit) -> Fit:
    """The fit as it stands at the angles that were meant: a tilt that was fitted would be told from
    the reading that it explains, and give a response the blame. Where settings were fitted to
    scatter beyond what hands do, rows are in the wrong place: there θ is that of the larger part
    of the rows that are alike."""
    data, at, prior = fit.observations, fit.at, fit.observations.noise_prior
    if not at.free:
        return fit
    theta, noise = fit.theta, fit.noise
    if prior is not None and max(noise.sd[: at.free], default=0.0) > FAR * prior.setting:
        held = [min(sd, prior.setting) for sd in noise.sd[: at.free]]
        noise = Noise(max(noise.factor, 1.0), at.component, (*held, *noise.sd[at.free :]))
        alike, start = data.take(alike_rows(data)), full_matrix_start(fit.model, data)
        again = fit_model(fit.model, alike, start=start, noise=noise)
        theta = theta if again.null_directions else again.theta
    meant = np.zeros_like(fit.eta)
    return replace(
        fit, theta=theta, eta=meant, noise=noise, at=balance(fit.model, theta, meant, data)
    )


def _once(base: Fit, components: tuple[Component, ...], terms: Terms) -> Explored:
    problem = problem_of(base, components)
    grams = grams_of(problem, terms)
    return Explored(base, problem, search(problem, grams), grams)


def near_values(found: Explored) -> dict[str, list[str]]:
    """Values of scans that stand in likely sets, by component."""
    near: dict[str, list[str]] = {}
    problem, posterior = found.problem, found.posterior
    for hypothesis, p in zip(posterior.hypotheses, posterior.probability, strict=True):
        for pick in hypothesis.picks if p > _LIKELY else ():
            choice = problem.choices[pick.choice]
            name = problem.components[choice.component].name
            value = choice.member.name.removeprefix(name)
            if name.endswith("@") and value not in near.get(name, []):
                near.setdefault(name, []).append(value)
    return near


def heard(found: Explored) -> Posterior:
    """The posterior at the noises that any leading set still gives a say."""
    posterior, problem = found.posterior, found.problem
    weights = [
        noises_of(problem, posterior.grams, h.picks)
        for h in (*posterior.hypotheses[:4], posterior.base)
    ]
    kept = np.flatnonzero(np.max(weights, axis=0) > np.exp(-HEARD / 2.0))
    return replace(posterior, grams=posterior.grams.of(kept))


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


def solved(
    problem: Problem, grams: Grams, hypothesis: Hypothesis, choices: Sequence[Choice] | None = None
) -> Solved:
    """The model of a set and its parameters, at the mean over the noises of these Grams."""
    every = problem.choices if choices is None else choices
    picks = [(every[p.choice], p.size) for p in hypothesis.picks]
    mean, covariance = _moments(problem, grams, blocks_of(every, hypothesis.picks))
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
    spread_of = turn @ covariance @ turn.T + np.diag(still**2)
    return Solved(model, theta + turn @ mean, spread_of, shrink)


def _moments(
    problem: Problem, grams: Grams, blocks: Sequence[tuple[Index, float]]
) -> tuple[Array, Array]:
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
    whole = np.zeros(problem.columns.shape[1])
    used = np.concatenate([np.arange(problem.base), *(c for c, _ in blocks)]).astype(np.intp)
    whole[used] = _moments(problem, grams, blocks)[0]
    whole[: problem.base] -= _moments(problem, grams, ())[0]
    numbers = len(problem.fit.at.owner)
    moved = problem.fit.at.unit * (problem.columns[:numbers] @ whole)
    return float(np.sqrt(moved @ moved / problem.fit.observations.n))


def _conditional(
    problem: Problem, grams: Grams, blocks: Sequence[tuple[Index, float]]
) -> tuple[Array, Array, Array]:
    """(E,) weight of each noise beside blocks of columns of given sizes, (E, k) the numbers of base
    and blocks there, and their covariance (E, k, k)."""
    columns = np.concatenate([np.arange(problem.base), *(c for c, _ in blocks)]).astype(np.intp)
    prior = np.concatenate(
        [np.zeros(problem.base), *(np.full(c.size, size**-2.0) for c, size in blocks)]
    )
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


def noises_of(problem: Problem, grams: Grams, picks: Sequence[Pick]) -> Array:
    """(E,) weight of each noise beside a set."""
    return _conditional(problem, grams, blocks_of(problem.choices, picks))[0]


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
