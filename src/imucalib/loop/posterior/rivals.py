"""The models that would do, as fits: for what is read from them, and for intervals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.core.fit import Fit
from imucalib.loop.posterior.problem import Problem
from imucalib.loop.posterior.solution import solved
from imucalib.loop.posterior.space import Posterior

#: Probability of a model that is weighed, and how many are at most.
_LEAST, _MOST = 0.005, 12


@dataclass(frozen=True)
class Rival:
    """One of the models that would do; weight : of all of them together, 1. The fit is that of the
    linear problem: its θ and their covariance, and the rest as in the base model's."""

    names: tuple[str, ...]
    weight: float
    fit: Fit


def rivals_of(problem: Problem, posterior: Posterior) -> tuple[Rival, ...]:
    """The likeliest sets, each as a fit."""
    pairs = zip(posterior.hypotheses, posterior.probability, strict=True)
    likely = [(h, float(p)) for h, p in pairs if p > _LEAST][:_MOST]
    total = sum(p for _, p in likely)
    context, found = problem.fit.observations.context, []
    for hypothesis, p in likely:
        one = solved(problem, posterior.grams, hypothesis)
        fit = replace(
            problem.fit,
            model=one.model,
            parameters=one.model.parameters(context),
            theta=one.theta,
            covariance=one.covariance,
            slope=np.zeros((0, one.theta.size, one.theta.size)),
            noise_covariance=np.zeros((0, 0)),
        )
        names = tuple(problem.components[c].name for c in hypothesis.components)
        found.append(Rival(names, p / total, fit))
    return tuple(found)
