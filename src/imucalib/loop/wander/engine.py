"""The closed loop of a worn sensor: noise, search, final fit, and the same within each fold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.errors import NotConverged
from imucalib.loop.design import Fold, folds_of
from imucalib.loop.found import FitLoop, LoopSettings, Step, Unexplained
from imucalib.loop.held_out import Held
from imucalib.loop.separation.worn import ambiguities
from imucalib.loop.wander import report
from imucalib.loop.wander.bank import Bank, parts_of
from imucalib.loop.wander.beside.every import beside_all
from imucalib.loop.wander.chance import by_chance, sure
from imucalib.loop.wander.choice import Refused, Rules, Search, search
from imucalib.loop.wander.confirm import confirmed, without
from imucalib.loop.wander.final import fitted
from imucalib.loop.wander.held_blocks import solved
from imucalib.loop.wander.left.axes import or_noise
from imucalib.loop.wander.left.corrected import corrected
from imucalib.loop.wander.left.ways import ways_left
from imucalib.loop.wander.likelihood import Level, Terms, best_level
from imucalib.loop.wander.noise import Noise, noise_of
from imucalib.loop.wander.probes import left_over as probed_of
from imucalib.loop.wander.problem import Problem, base_precision, problem_of
from imucalib.loop.wander.scores import Scored
from imucalib.loop.wander.sums import sums_of
from imucalib.loop.wander.words import (
    beside_left,
    looked_like,
    scores_of,
    steps_of,
    unexplained,
)

#: Rows that a search uses at most: more change no decision.
_ROWS = 3000
#: Chance that the best of all candidates reaches the bar where nothing is missing, at most.
_ALPHA = 0.02
_NO_INVERSE = "with it some readings have no inverse, so that nothing can be corrected by it"


@dataclass(frozen=True)
class Asked:
    """effects, families : what is tried; known : (n,) mg², the part of each run's variance that
    its windows and the resolution explain; probes : what the user keeps out of a search, but not
    out of what it leaves over"""

    effects: Mapping[str, Effect]
    families: tuple[Family, ...]
    known: Array
    rules: LoopSettings
    probes: tuple[Family, ...] = ()


@dataclass(frozen=True)
class Closed:
    """base, final : under the noise with its walk; base_held, final_held : every row predicted by
    a search and a fit without its block; light : runs that count less"""

    loop: FitLoop
    base_held: Held
    final_held: Held
    light: int


@dataclass(frozen=True)
class _Pass:
    """One search of the whole data. chances : of every round, (2, draws) evidence of the best on
    data that lack nothing; bars : (2,) of every round; neither where another search follows"""

    problem: Problem
    level: Level
    chances: tuple[Array, ...]
    bars: tuple[Array, ...]
    search: Search


def close(base: Fit, asked: Asked, rng: np.random.Generator) -> Closed:
    """Search beside a fitted base model, and measure on blocks of time what that was worth.

    What was missing made runs look strange and the noise large: when something is found, the
    search runs once more with the noise that is left beside it. Only that noise is kept of the
    first, which tries walks of the fitted memory, as folds do, and others where it finds nothing.
    """
    data = base.observations
    folds = folds_of(data)
    part = parts_of(folds, data.n)
    noise = noise_of(base, asked.known, part, base_precision(base))
    found = _searched(base, noise, folds, asked, rng)
    if found.search.taken:
        _, final, precision = _undoable(found)
        noise = noise_of(final, asked.known, part, precision, base.theta.size)
        found = _searched(base, noise, folds, asked, rng, last=True)
    return _told(found, folds, part, asked, rng)


def _searched(
    base: Fit, noise: Noise, folds: tuple[Fold, ...], asked: Asked, rng: np.random.Generator,
    *, last: bool = False,
) -> _Pass:  # fmt: skip
    rules = asked.rules
    plain = fitted(base.model, base.observations, noise, base.theta, base_precision(base))
    rows = min(rules.most_scored, _ROWS)
    problem = problem_of(plain, noise, asked.effects, asked.families, folds, rows)
    bank, terms = problem.bank, problem.terms
    keep = np.ones(bank.course.parts, dtype=bool)
    drawn: dict[int, Array] = {}
    alpha = min(rules.alpha, _ALPHA) / 2.0
    enough = sure(rules.draws, len(problem.entries) * len(bank.walks))

    def draw(bank: Bank, terms: Terms, turn: int) -> Array:
        if turn not in drawn:
            drawn[turn] = by_chance(bank, terms, problem.entries, rng, rules.draws)
        return np.asarray(np.quantile(drawn[turn], 1.0 - alpha, axis=1))

    def tried(bank: Bank, terms: Terms, turn: int, scores: Sequence[Scored]) -> Iterator[Array]:
        if scores[0].evidence >= enough and not scores[0].entry.timed:
            yield np.array([enough, np.inf])
        if last or not turn:  # else the next search draws its own
            yield draw(bank, terms, turn)

    for same_tau in (False,) if last else (True, False):
        decide = Rules(tried, rules.most_effects, problem.finer, problem.forms, same_tau)
        found = search(bank, terms, problem.entries, problem.splits, keep, decide)
        if found.taken:
            break
    if not drawn and (last or not found.taken):  # which only the report asks for
        draw(found.bank, found.terms, len(found.taken))
    chances = tuple(_nearest(drawn, turn) for turn in range(len(found.taken) + 1) if drawn)
    bars = tuple(np.quantile(chance, 1.0 - alpha, axis=1) for chance in chances)
    level = best_level(bank, terms, keep)
    if found.taken and not last:
        return _Pass(problem, level, chances, bars, found)
    # The base under its own walk, which is larger than what is left beside the final model.
    scatter = noise.scatter * float(np.sqrt(level.variance))
    own = replace(noise, walk=bank.walks[level.walk], scatter=scatter)
    plain = fitted(base.model, base.observations, own, plain.theta, base_precision(base))
    return _Pass(replace(problem, fit=plain), level, chances, bars, found)


def _nearest(drawn: Mapping[int, Array], turn: int) -> Array:
    """Of the round itself, or of the next one for which data were drawn, or of the last."""
    return drawn[min((t for t in drawn if t >= turn), default=max(drawn))]


def _final(found: _Pass) -> tuple[Fit, Array]:
    """The model with all that was taken, and its priors' precisions; scans at their best value."""
    problem, taken = found.problem, found.search.taken
    precision = problem.precision(taken)
    model, level = problem.model(taken), found.search.level
    keep = np.ones(found.search.bank.course.parts, dtype=bool)
    values = solved(found.search.bank, found.search.terms, level.walk, keep)
    start = problem.theta(values, taken)
    noise = replace(problem.noise, walk=problem.bank.walks[level.walk])
    return fitted(model, problem.fit.observations, noise, start, precision), precision


def _undoable(found: _Pass) -> tuple[_Pass, Fit, Array]:
    """The search without effects of the response that leave readings without an inverse, the last
    ones first, and its final model: who cannot be corrected by an effect has no use of it."""
    refused = list[Refused]()
    while found.search.taken:
        try:
            return found, *_final(found)
        except NotConverged:
            of_response = [t for t in found.search.taken if t.found.entry.of_response]
            last = (of_response or found.search.taken)[-1]
            refused.append(Refused(last.found.entry.name, last.found, _NO_INVERSE))
            left = without(found.search, refused[-1:], found.problem.terms)
            found = replace(found, search=left)
    return found, found.problem.fit, base_precision(found.problem.fit)


def _probed(
    final: Fit, last: Noise, folds: tuple[Fold, ...], asked: Asked, rng: np.random.Generator
) -> tuple[Unexplained, ...]:
    """What the user keeps out of a search, in what it leaves over."""
    if not asked.probes:
        return ()
    return probed_of(
        final, last, asked.probes, folds, rows=min(asked.rules.most_scored, _ROWS),
        draws=asked.rules.draws, alpha=min(asked.rules.alpha, _ALPHA), rng=rng,
    )  # fmt: skip


def _told(
    found: _Pass, folds: tuple[Fold, ...], part: NDArray[np.intp], asked: Asked,
    rng: np.random.Generator,
) -> Closed:  # fmt: skip
    problem, bars = found.problem, found.bars
    near = report.walks_of_note(found.search)
    each = report.predicted(problem, folds, Rules(
        lambda bank, terms, turn, scores: (bars[min(turn, len(bars) - 1)],),
        asked.rules.most_effects, problem.finer, problem.forms, True, near,
    ))  # fmt: skip
    gained = report.held_difference(each, folds)
    if found.search.taken:
        steps = steps_of(problem, found.search, found.chances)
        beside = partial(report.beside_its_moment, each, folds, problem.time)
        kept = confirmed(found.search, steps, bars, problem.terms, each, beside)
        found = replace(found, search=kept)
    found, final, precision = _undoable(found)
    steps = steps_of(problem, found.search, found.chances)
    steps = beside_all(problem, found.search, steps, final)
    bent = corrected(problem, found.search, each, folds, partial(ways_left, problem), asked.rules)
    if bent.steps:
        each = bent.each
        _, final, precision = _undoable(replace(found, search=bent.search))
    last = noise_of(final, asked.known, part, precision, problem.terms.base)
    if found.search.taken or bent.steps:
        with suppress(NotConverged):  # else it stays as it is, which has an inverse
            final = fitted(final.model, final.observations, last, final.theta, precision)
    refused = looked_like(
        found.search.refused,
        steps,
        found.chances[-1],
        lambda n: " and ".join(problem.effect(n).needs),
    )
    refused = (*refused, *_probed(final, last, folds, asked, rng))
    told = bent.told if refused else or_noise(bent.told, final, last, asked.known)
    left_over = (*refused, *told, *unexplained(last.wandering))
    loop = replace(
        _loop(found, final, steps, left_over),
        steps=(*beside_left(found.search, steps, left_over), *bent.steps),
        difference=report.held_difference(each, folds) if bent.steps else gained,
        doubted=bool(found.search.taken) and not gained.proved,
        wander=last.wandering,
    )
    return Closed(loop, each.before, each.after if loop.steps else each.before, last.light)


def _loop(
    found: _Pass, final: Fit, steps: tuple[Step, ...], left: tuple[Unexplained, ...]
) -> FitLoop:
    problem, chances, bars = found.problem, found.chances, found.bars
    return FitLoop(
        base=problem.fit,
        final=final,
        plain=problem.fit,
        as_recorded=final,
        ambiguous=ambiguities(problem, found.search, steps),
        sums=sums_of(problem, found.level, problem.fit),
        rejected=tuple((r.name, r.reason) for r in found.search.refused),
        unexplained=left,
        scores=scores_of(problem, found.search.last, chances[-1], bars[-1]),
        first_scores=scores_of(problem, found.search.first, chances[0], bars[0]),
        missing=problem.missing,
        bar=float(bars[0][0]),
    )
