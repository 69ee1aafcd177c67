"""What the data say of every component alone, and what could hide: for reports and plans."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.evidence import Score
from imucalib.loop.posterior.gram import swept
from imucalib.loop.posterior.problem import Problem
from imucalib.loop.posterior.space import Posterior


def scores_of(problem: Problem, posterior: Posterior) -> tuple[Score, ...]:
    """Every component, likeliest first, by its first member at typical size.

    Its evidence beside the base model alone, the probability that it is not there in `p`, and what
    the base model leaves of it at the likeliest noise.
    """
    grams = posterior.grams
    base = swept(grams, *problem.flat)
    logs = base.log_weight + base.log_noise(base.power, posterior.dof)
    noise = np.array([int(np.argmax(logs))])
    one, n = base.of(noise), len(problem.fit.at.owner)
    basis = np.linalg.qr(problem.columns[:n, : problem.base])[0]
    factor = float(np.sqrt(one.power[0] / posterior.dof))
    evidence, inside = of_each(posterior, len(problem.components))
    found, seen = [], set[int]()
    for choice in problem.choices:
        if choice.component in seen:
            continue
        seen.add(choice.component)
        component = problem.components[choice.component]
        index = choice.at[None]
        power = max(float(np.trace(one.blocks(index)[0, 0])), 0.0)
        columns = problem.columns[:n, choice.at]
        rest = columns - basis @ (basis.T @ columns)
        sized = columns * problem.fit.at.unit[:, None]
        found.append(
            Score(
                name=component.name,
                kind="effect" if component.named else "probe",
                driver=component.driver,
                evidence=float(evidence[choice.component]),
                p=float(1.0 - inside[choice.component]),
                left=float(np.sum(rest**2) / np.sum(columns**2)),
                strength=float(np.sqrt(power)) / factor,
                size=float(np.linalg.norm(sized) / problem.fit.observations.n**0.5),
            )
        )
    return tuple(sorted(found, key=lambda s: s.p))


def of_each(posterior: Posterior, count: int) -> tuple[Array, Array]:
    """(C,) nats of each component by itself beside the base model, and (C,) the probability that it
    is there; count : how many there are"""
    evidence, inside = np.zeros(count), np.zeros(count)
    for hypothesis, p in zip(posterior.hypotheses, posterior.probability, strict=True):
        inside[list(hypothesis.components)] += p
        if len(hypothesis.components) == 1:
            evidence[hypothesis.components[0]] = hypothesis.evidence - posterior.base.evidence
    return evidence, np.minimum(inside, 1.0)
