"""Effects that a later one has put behind a rival, which takes their place."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.found import Step
from imucalib.loop.records import reduced
from imucalib.loop.rivals.models import scored_beside
from imucalib.loop.search import objection
from imucalib.loop.thresholds import KEEP, STRONG


def exchanged(
    fit: Fit, steps: tuple[Step, ...], extended: Callable[[Fit, Effect], Fit]
) -> tuple[Fit, tuple[Step, ...]]:
    """The fit with the best of each step's set beside all other effects, and the steps as they are
    then.

    An effect that was taken alone had the trace of those that were still missing to explain: with
    these in the model one of its rivals may lead. What is then ten nats behind is no rival.

    extended : the refit with one more effect
    """
    done = []
    for step in steps:
        fit, best = _contested(fit, step, extended)
        done.append(best)
    return fit, tuple(done)


def _contested(fit: Fit, step: Step, extended: Callable[[Fit, Effect], Fit]) -> tuple[Fit, Step]:
    every = (step.effect, *step.aliases)
    effects = {n: e for n in every if (e := known(n)) is not None}
    if len(effects) < 2 or step.effect not in fit.model.names:
        return fit, step
    without = reduced(fit, (step.effect,))
    nats = {s.name: s.evidence for s in scored_beside(without, effects.values())}
    best = max(nats, key=lambda name: nats[name])
    if nats[best] < nats.get(step.effect, 0.0) + KEEP:
        return fit, step
    trial = extended(without, effects[best])
    if objection(without, trial):
        return fit, step
    gone = {best, *(name for name in nats if nats[name] < nats[best] - STRONG)}
    others = tuple(name for name in every if name not in gone)
    return trial, replace(step, effect=best, evidence=nats[best], aliases=others)
