"""Structure without a cause, corrected by a curve or a form where that holds out.

What swings, jumps or moves with time is told; its course is known well within the recording, and a
reading of that time is better without it. In every search without a block the likeliest of its kind
takes its place, so that what the blocks say includes the choice of a period or a moment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.effects import known
from imucalib.loop.design import Fold
from imucalib.loop.found import Checked, LoopSettings, Step, Unexplained
from imucalib.loop.wander.bank import Mask
from imucalib.loop.wander.beside.parts import narrowed
from imucalib.loop.wander.choice import Search, Taken
from imucalib.loop.wander.left.strongest import Told, Way, chance_bar, strongest
from imucalib.loop.wander.left.wandering import WANDER, follows, wandering
from imucalib.loop.wander.likelihood import Terms, best_level, levels
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.report import Predicted, blocks_of, held_difference, predicted_by
from imucalib.loop.wander.scores import SIZES, Entry, Scored, beside, joined, kind_of

#: Corrections at most; share of the searches without a block that must find one again; nats behind
#: the likeliest from which on a way is none without one block of twelve either.
_MOST, _AGAIN, _BEHIND = 3, 0.8, 40.0
#: Values tried between the neighbours of a period or of a moment.
_FINER = 11
Ways = Callable[[Search], Sequence[Sequence[Way]]]


@dataclass(frozen=True)
class Corrected:
    """search : with what corrects behind what was named; steps : of those; told : all structure,
    with what is left beside; each : the blocks, foretold with all"""

    search: Search
    steps: tuple[Step, ...]
    told: tuple[Unexplained, ...]
    each: Predicted


def corrected(
    problem: Problem, named: Search, each: Predicted, folds: Sequence[Fold], ways: Ways,
    rules: LoopSettings,
) -> Corrected:  # fmt: skip
    """Correct what is told beside what was named, the likeliest first; without curves, tell it."""
    now = narrowed(problem.terms, named)
    if not named.taken:
        each = _of_the_base(problem, each)
    steps, told = list[Step](), list[Unexplained]()
    left = strongest(now, *(groups := ways(now)))
    while left is not None and rules.curves and len(steps) < _MOST:
        able = [[way for way in group if _may(way, rules.quicker)] for group in groups]
        found = left if _may(left.way, rules.quicker) else strongest(now, *able)
        trial = None if found is None else _trial(problem, now, each, folds, found, able)
        if found is None or trial is None:
            break
        now, each, step = trial
        steps.append(replace(step, draws=rules.draws))
        told.append(found.structure)
        left = strongest(now, *(groups := ways(now)))
    wander = wandering(problem, now) if rules.curves and rules.quicker is None else None
    if wander is not None:
        trial = _trial(problem, now, each, folds, wander, [[wander.way]])
        if trial is not None:
            now, each, step = trial
            steps.append(replace(step, draws=rules.draws))
            told.append(wander.structure)
    rest = () if left is None else (left.structure,)
    return Corrected(now, tuple(steps), (*told, *rest), each)


def _may(way: Way, quicker: float | None) -> bool:
    """Whether a way may be corrected: of what moves with time, where parts follow it, only what
    swings in less than so many seconds."""
    if not way.effect or quicker is None or way.driver != "time":
        return bool(way.effect)
    return way.kind == "swing" and float(way.effect.rpartition(":")[2]) < quicker


def _of_the_base(problem: Problem, each: Predicted) -> Predicted:
    """The blocks, foretold without what some searches took and the whole did not."""
    bare = []
    for split, search in zip(problem.splits, each.searches, strict=True):
        level = best_level(search.bank, problem.terms, split.train)
        bare.append(replace(search, terms=problem.terms, level=level, taken=()))
    return replace(each, after=each.before, gains=0.0 * each.gains, searches=tuple(bare))


def _trial(
    problem: Problem, now: Search, each: Predicted, folds: Sequence[Fold], found: Told,
    able: Sequence[Sequence[Way]],
) -> tuple[Search, Predicted, Step] | None:  # fmt: skip
    """The search and the blocks with what corrects it, and the step, where that holds out."""
    keep = np.ones(now.bank.course.parts, dtype=bool)
    follow = found.way.kind == WANDER
    with_it, taken = _with(problem, now, found.way, keep)
    if taken is None or (follow and not follows(now.terms, with_it)):
        return None
    searches = _each(problem, each, _near(now, found.way, able), always=follow)
    again = sum(
        len(new.taken) > len(old.taken) for new, old in zip(searches, each.searches, strict=True)
    )
    after = predicted_by(problem, folds, searches, each.before)
    but = blocks_of(taken.found.entry.name, folds, problem.time)
    both = replace(after, before=each.after, gains=after.gains - each.gains)
    gained = held_difference(both, folds, but)
    held = gained.nats > 0.0 and (gained.gain if follow else gained.plain_low) > 0.0
    if again < _AGAIN * len(folds) or not held:
        return None
    errors = [float(np.mean(np.abs(held.error))) for held in (each.after, after.after)]
    step = Step(
        effect=taken.found.entry.name, p=found.structure.p, draws=0,
        evidence=found.structure.evidence, checked=(Checked("error", "m/s2", *errors),),
        aliases=(), curve=True, gains=tuple(float(g) for g in after.gains - each.gains),
    )  # fmt: skip
    return with_it, after, step


def _near(now: Search, way: Way, able: Sequence[Sequence[Way]]) -> list[Way]:
    """Ways of its kind that may be the likeliest where a block is left out."""
    alike = [w for group in able for w in group if (w.kind, w.driver) == (way.kind, way.driver)]
    keep = np.ones(now.bank.course.parts, dtype=bool)
    gains = _gains(now, keep, [w.columns for w in alike]).max(axis=1)
    return [w for w, nats in zip(alike, gains, strict=True) if nats > gains.max() - _BEHIND]


def _each(problem: Problem, each: Predicted, near: Sequence[Way], *, always: bool) -> list[Search]:
    """The searches without a block, each with the likeliest of the ways. always : however likely"""
    searches = list[Search]()
    for split, search in zip(problem.splits, each.searches, strict=True):
        nats = _gains(search, split.train, [way.columns for way in near]).max(axis=1)
        best = int(np.argmax(nats))
        if always or nats[best] >= chance_bar(len(near), 1):
            search, _ = _with(problem, search, near[best], split.train)  # noqa: PLW2901
        searches.append(search)
    return searches


def _gains(search: Search, keep: Mask, blocks: Sequence[Array]) -> Array:
    """(blocks, sizes) nats that each gains under the noise as it is, or where that is white."""
    every = levels(search.bank, search.terms, keep)
    best = np.full((len(blocks), len(SIZES)), -np.inf)
    for walk in sorted({0, search.level.walk}):
        gain = beside(search.bank, search.terms, keep, walk, blocks, SIZES)
        best = np.maximum(best, gain + every[walk].nats - every[search.level.walk].nats)
    return best


def _with(problem: Problem, search: Search, way: Way, keep: Mask) -> tuple[Search, Taken | None]:
    """The search with the effect that corrects a way best, as far as the data that are kept say."""
    found = [e for e in map(known, _finer(way.effect, search)) if e is not None]
    tried = problem.columns_of(found)
    if not tried:
        return search, None
    gains = _gains(search, keep, [columns for _, columns in tried])
    k, size = (int(v) for v in np.unravel_index(int(np.argmax(gains)), gains.shape))
    name, columns = tried[k]
    effect = next(e for e in found if e.name == name)
    entry = Entry(name, "", kind_of(effect), np.zeros(0, np.intp))
    nats = float(gains[k, size])
    score = Scored(entry, nats, search.level.walk, SIZES[size], left=0.0, strength=0.0, share=0.0)
    bank, score = joined(search.bank, score, name, columns)
    terms: Terms = search.terms.plus(score.entry.columns, SIZES[size])
    taken = Taken(score, SIZES[size], np.zeros(0), 0.0, 0.0, ())
    level = best_level(bank, terms, keep)
    both = replace(search, bank=bank, terms=terms, level=level, taken=(*search.taken, taken))
    return narrowed(problem.terms, both), taken


def _finer(effect: str, search: Search) -> list[str]:
    """Names of the effect with its period or moment varied to half of the step between two."""
    head, _, value = effect.rpartition(":")
    if not effect.startswith("shape@"):
        return [effect]
    time, at = search.bank.course.time, float(value)
    span = float(np.ptp(time))
    around = np.linspace(-0.5, 0.5, _FINER)
    if head.endswith(":sine"):
        return [f"{head}:{span / (span / at + step):.6g}" for step in around]
    place = np.searchsorted(time, at) + np.round(around * time.size / 12.0).astype(int)
    inside = np.unique(np.clip(place, 1, time.size - 1))
    return [f"{head}:{0.5 * (time[k - 1] + time[k]):.10g}" for k in inside]
