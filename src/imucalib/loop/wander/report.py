"""Before and after on blocks of time that took no part: noise, choice and fit without each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import NotConverged
from imucalib.loop.design import Fold
from imucalib.loop.difference import Difference, difference, with_density
from imucalib.loop.held_out import Held, errors
from imucalib.loop.wander.choice import Rules, Search, Taken, search
from imucalib.loop.wander.forms import driver_of
from imucalib.loop.wander.held_blocks import judged, solved
from imucalib.loop.wander.likelihood import Terms, best_level
from imucalib.loop.wander.problem import Problem


@dataclass(frozen=True)
class Predicted:
    """Every row predicted without its block, before and after; gains : (k,) nats that each block's
    density gains; found : names or scans that the search without each block took, and the
    drivers that forms may bend with"""

    before: Held
    after: Held
    gains: Array
    found: tuple[frozenset[str], ...]


def walks_of_note(found: Search) -> frozenset[int]:
    """Walks under which some candidate came near its best, in any round of a search."""
    rounds = [*(taken.rivals for taken in found.taken), found.last]
    return frozenset(walk for scores in rounds for score in scores for walk in score.near)


def predicted(problem: Problem, folds: Sequence[Fold], rules: Rules) -> Predicted:
    """Steps of the whole search, without one block and its gap at a time."""
    bank, data = problem.bank, problem.fit.observations
    parts: list[tuple[Held, Held]] = []
    gains, names = list[float](), list[frozenset[str]]()
    for k, (fold, split) in enumerate(zip(folds, problem.splits, strict=True)):
        others = [s for j, s in enumerate(problem.splits) if j != k]
        found = search(bank, problem.terms, problem.entries, others, split.train, rules)
        plain = best_level(bank, problem.terms, split.train)
        held = data.take(fold.rows)

        def errors_of(terms: Terms, walk: int, taken: tuple[Taken, ...]) -> Held:
            values = solved(found.bank, terms, walk, split.train)  # noqa: B023
            fit = replace(problem.fit, model=problem.model(taken))
            return errors(fit, problem.theta(values, taken), held)  # noqa: B023

        before = errors_of(problem.terms, plain.walk, ())
        after = before
        gain = 0.0
        if found.taken:
            try:
                after = errors_of(found.terms, found.level.walk, found.taken)
            except NotConverged:  # what has no inverse corrects nothing
                found = replace(found, taken=())
            else:
                one = judged(bank, problem.terms, plain.walk, [split])
                two = judged(found.bank, found.terms, found.level.walk, [split])
                gain = float(two.nats[0] - one.nats[0])
        parts.append((before, after))
        gains.append(gain)
        taken = [t.found.entry for t in found.taken]
        own = {entry.name.partition("@")[0] for entry in taken}
        names.append(frozenset(own | {driver_of(entry) for entry in taken}))
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))
    return Predicted(
        _joined([a for a, _ in parts], order),
        _joined([b for _, b in parts], order),
        np.array(gains),
        tuple(names),
    )


def held_difference(each: Predicted, folds: Sequence[Fold]) -> Difference:
    """The difference of the mean errors in m/s², with what the log density of the blocks gains."""
    part = np.empty(sum(fold.rows.size for fold in folds), dtype=np.intp)
    for k, fold in enumerate(folds):
        part[fold.rows] = k
    before, after = (np.abs(held.error[:, 0, 0]) for held in (each.before, each.after))
    found = difference(before, after, part, len(folds), "mean")
    return with_density(found, each.gains, decides=False)


def _joined(parts: list[Held], order: NDArray[np.intp]) -> Held:
    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))
