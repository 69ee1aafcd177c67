"""What a limited search leaves over: responses that it was not let to take, and only tells."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.core.effect import Family
from imucalib.core.fit import Fit
from imucalib.loop.design import Fold
from imucalib.loop.found import Unexplained
from imucalib.loop.wander.chance import null_of
from imucalib.loop.wander.final import fitted
from imucalib.loop.wander.likelihood import levels
from imucalib.loop.wander.noise import Noise, usable_walks
from imucalib.loop.wander.problem import base_precision, problem_of
from imucalib.loop.wander.scores import scored
from imucalib.loop.wander.words import chance_of


def left_over(
    final: Fit, noise: Noise, probes: Sequence[Family], folds: tuple[Fold, ...], *,
    rows: int, draws: int, alpha: float, rng: np.random.Generator,
) -> tuple[Unexplained, ...]:  # fmt: skip
    """The best of the probes beside a final model, where its chance on data that lack nothing is
    `alpha` at most. rows : that are scored at most; draws : simulated data sets"""
    plain = fitted(final.model, final.observations, noise, final.theta, base_precision(final))
    problem = problem_of(plain, noise, {}, probes, folds, rows)
    bank, terms = problem.bank, problem.terms
    keep = np.ones(bank.course.parts, dtype=bool)
    if not problem.entries:
        return ()
    every = levels(bank, terms, keep)
    null = null_of(bank, every, rng, draws, range(len(bank.walks)))
    walks = usable_walks(bank, max(every, key=lambda one: one.nats), same_tau=False)
    scores, chance = scored(bank, terms, keep, problem.entries, walks, null)
    best = scores[0]
    p = chance_of(best, chance)
    if p > alpha:
        return ()
    if best.entry.kind == "posture":
        name = "offset against the posture"
        return (Unexplained(name, "posture", "curve", p, best.evidence, best.share),)
    axes = best.entry.name.partition("@")[2]
    axis = axes if len(axes) == 1 else "each axis"
    name = f"response of {axis} against its own input"
    return (Unexplained(name, axis, "curve", p, best.evidence, best.share),)
