"""A fitted base model with the posterior over what it lacks, scans refined where they count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.core.balance import Noise, balance
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.starting_point import alike_rows, full_matrix_start
from imucalib.loop.asked import Searched
from imucalib.loop.posterior.catalogue import components_of, scan_of
from imucalib.loop.posterior.component import Component
from imucalib.loop.posterior.gram import Grams, grams_of
from imucalib.loop.posterior.noise import Terms, terms_of
from imucalib.loop.posterior.odds import FAR, HEARD
from imucalib.loop.posterior.problem import Problem, problem_of
from imucalib.loop.posterior.solution import noises_of
from imucalib.loop.posterior.space import Posterior, search

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
