"""Before and after on rows that took no part in any choice: the search anew without each fold.

The folds are one design, fixed by the structure of the data. In each, every choice is made and
every number estimated without the fold's rows, by down-dates of the same products.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import Undetermined
from imucalib.posterior.closed_loop.words import select_model
from imucalib.posterior.held_out import Fold, Predictions, errors, join, leaves_determined
from imucalib.posterior.odds import FOLD_BEAMS, FOLD_DEEPEST, SEEN, SINGLES
from imucalib.posterior.search.gram import Grams, leave_out, marginalize, select_columns
from imucalib.posterior.search.problem import Problem
from imucalib.posterior.search.solution import solve
from imucalib.posterior.search.space import Posterior, blocks_of, search


@dataclass(frozen=True)
class LeftOut:
    """Predictions of every observation without its fold, by the base model and by what a search
    finds there

    nats : (K,) of log density that each fold gains by it
    """

    before: Predictions
    after: Predictions
    nats: Array


def leave_folds_out(problem: Problem, posterior: Posterior, folds: Sequence[Fold]) -> LeftOut:
    """Every fold of a design, in the order of the observations. Raises Undetermined where the rest
    of one determines the base no more: what it reads can be foretold by nobody."""
    problem, grams = _select_columns(problem, posterior)
    every, whole = np.arange(problem.fit.observations.n), marginalize(grams, problem.flat)
    base = _information(problem, grams)
    deepest = min(FOLD_DEEPEST, len(select_model(problem, posterior).hypothesis.components) + 1)
    before, after, nats = list[Predictions](), list[Predictions](), list[float]()
    for fold in folds:
        kept = leave_out(grams, problem, np.setdiff1d(every, fold.rest))
        if not leaves_determined(base, _information(problem, kept)):
            labels = [problem.fit.observations.label[k] for k in fold.rows]
            raise Undetermined(
                f"without {', '.join(labels)} the others determine the sensor no more",
                remedy="record more positions",
            )
        found = search(problem, kept, beams=FOLD_BEAMS, deepest=deepest)
        said = select_model(problem, found).hypothesis
        # The fold's rows given all others, by the set that is told over the base model.
        blocks = blocks_of(problem.choices, said.picks)
        gains = [
            marginalize(given, *blocks).evidence(dof) - given.evidence(dof)
            for given, dof in ((whole, posterior.dof), (marginalize(kept, problem.flat), found.dof))
        ]
        nats.append(gains[0] - gains[1])
        held = problem.fit.observations.take(fold.rows)
        for hypothesis, out in ((found.base, before), (said, after)):
            one = solve(problem, kept, hypothesis)
            fit = replace(problem.fit, model=one.model, theta=one.theta)
            out.append(errors(fit, one.theta, held))
    rows = [fold.rows for fold in folds]
    return LeftOut(join(before, rows), join(after, rows), np.array(nats))


def base_left_out(problem: Problem, posterior: Posterior, folds: Sequence[Fold]) -> Predictions:
    """Predictions of every observation without its fold by the base model alone. Raises
    Undetermined where the rest of a fold does not determine it."""
    return leave_folds_out(replace(problem, choices=()), posterior, folds).before


def _information(problem: Problem, grams: Grams) -> Array:
    """(p, p) what the data say of the base, at the first noise."""
    columns = np.arange(problem.base)
    return np.asarray(grams.of(np.zeros(1, np.intp)).rows(columns)[0][:, columns])


def _select_columns(problem: Problem, posterior: Posterior) -> tuple[Problem, Grams]:
    """The problem and its products with the members of every component that any data have a say
    for."""
    heard = components_heard(posterior)
    choices = tuple(c for c in problem.choices if c.component in heard)
    last = problem.columns.shape[1] - 1
    used = np.unique(np.concatenate([np.arange(problem.base), *(c.at for c in choices), [last]]))
    grams = select_columns(posterior.grams, used)
    found = replace(
        problem,
        columns=problem.columns[:, used],
        choices=tuple(replace(c, at=np.searchsorted(used, c.at)) for c in choices),
    )
    return found, replace(grams, columns=found.columns[: len(grams.columns)])


def components_heard(posterior: Posterior) -> set[int]:
    """Components that a part of the data may have a say for: those of likely sets, and the
    likeliest that stand alone."""
    used = {c for h, p in posterior.weighed if p > SEEN for c in h.components}
    single = [h for h in posterior.hypotheses if len(h.components) == 1][:SINGLES]
    return used | {h.components[0] for h in single}
