"""Before and after on blocks of time that took no part: noise, choice and fit without each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.effects.history.step import moment_of
from imucalib.errors import NotConverged
from imucalib.loop.design import Fold
from imucalib.loop.difference import Difference, difference, with_density
from imucalib.loop.held_out import Held, errors
from imucalib.loop.wander.beside.parts import narrowed
from imucalib.loop.wander.choice import Rules, Search, Taken, search
from imucalib.loop.wander.forms import driver_of
from imucalib.loop.wander.held_blocks import judged, solved
from imucalib.loop.wander.likelihood import Terms, best_level
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.walk import Walk


@dataclass(frozen=True)
class Predicted:
    """Every row predicted without its block, before and after; gains : (k,) nats that each block's
    density gains; searches : without each block, their banks of what they took alone"""

    before: Held
    after: Held
    gains: Array
    searches: tuple[Search, ...]

    @property
    def found(self) -> tuple[frozenset[str], ...]:
        """Names or scans that the search without each block took, and the drivers that forms may
        bend with."""
        each = ([t.found.entry for t in search.taken] for search in self.searches)
        return tuple(
            frozenset({e.name.partition("@")[0] for e in taken} | {driver_of(e) for e in taken})
            for taken in each
        )


def walks_of_note(found: Search) -> frozenset[Walk]:
    """Walks under which some candidate came near its best, in any round of a search."""
    rounds = [*(taken.rivals for taken in found.taken), found.last]
    near = {walk for scores in rounds for score in scores for walk in score.near}
    return frozenset(found.bank.walks[walk] for walk in near)


def predicted(problem: Problem, folds: Sequence[Fold], rules: Rules) -> Predicted:
    """Steps of the whole search, without one block and its gap at a time, under the walks that
    decide something and none."""
    searches = list[Search]()
    bank = problem.bank.under(rules.near) if rules.near else problem.bank
    for k, split in enumerate(problem.splits):
        others = [s for j, s in enumerate(problem.splits) if j != k]
        found = search(bank, problem.terms, problem.entries, others, split.train, rules)
        searches.append(narrowed(problem.terms, found))
    return predicted_by(problem, folds, searches)


def predicted_by(
    problem: Problem, folds: Sequence[Fold], searches: Sequence[Search], known: Held | None = None
) -> Predicted:
    """What searches without one block each, in their order, foretell of it.

    known : what the base foretells, where that was asked before
    """
    data, ends, gains = problem.fit.observations, list[Search](), list[float]()
    parts: list[tuple[Held, Held]] = []
    for fold, split, found in zip(folds, problem.splits, searches, strict=True):
        bank = found.bank
        plain = best_level(bank, problem.terms, split.train)
        held = data.take(fold.rows)

        def errors_of(terms: Terms, walk: int, taken: tuple[Taken, ...]) -> Held:
            values = solved(bank, terms, walk, split.train)  # noqa: B023
            fit = replace(problem.fit, model=problem.model(taken))
            return errors(fit, problem.theta(values, taken), held)  # noqa: B023

        before = errors_of(problem.terms, plain.walk, ()) if known is None else known.of(fold.rows)
        after, gain, end = before, 0.0, found
        if found.taken:
            try:
                after = errors_of(found.terms, found.level.walk, found.taken)
            except NotConverged:  # what has no inverse corrects nothing
                end = replace(found, terms=problem.terms, level=plain, taken=())
            else:
                one = judged(bank, problem.terms, plain.walk, [split])
                two = judged(bank, found.terms, found.level.walk, [split])
                gain = float(two.nats[0] - one.nats[0])
        parts.append((before, after))
        gains.append(gain)
        ends.append(end)
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))
    before, after = (_joined([pair[k] for pair in parts], order) for k in (0, 1))
    return Predicted(before, after, np.array(gains), tuple(ends))


def held_difference(
    each: Predicted, folds: Sequence[Fold], but: frozenset[int] = frozenset()
) -> Difference:
    """The difference of the mean errors in m/s², with what the log density of the blocks gains.

    but : blocks that take no part
    """
    part = part_of(folds)
    rows = ~np.isin(part, list(but))
    before, after = (np.abs(held.error[rows, 0, 0]) for held in (each.before, each.after))
    found = difference(before, after, part[rows], len(folds) - len(but), "mean")
    nats = np.delete(each.gains, list(but))
    return with_density(found, nats)


def beside_its_moment(
    each: Predicted, folds: Sequence[Fold], time: Array, taken: Taken
) -> Difference:
    """What the blocks gain but for the one in which an effect begins."""
    return held_difference(each, folds, blocks_of(taken.found.entry.name, folds, time))


def blocks_of(name: str, folds: Sequence[Fold], time: Array) -> frozenset[int]:
    """Blocks, gap included, in which an effect of this name begins: without one nobody knows when.

    time : (n,) s of the rows
    """
    at = moment_of(name)
    spans = [time[np.setdiff1d(np.arange(time.size), fold.rest)] for fold in folds]
    return frozenset(k for k, span in enumerate(spans) if span.min() <= at <= span.max())


def part_of(folds: Sequence[Fold]) -> NDArray[np.intp]:
    """(n,) the block of every row."""
    part = np.empty(sum(fold.rows.size for fold in folds), dtype=np.intp)
    for k, fold in enumerate(folds):
        part[fold.rows] = k
    return part


def _joined(parts: list[Held], order: NDArray[np.intp]) -> Held:
    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))
