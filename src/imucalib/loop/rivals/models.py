"""The final model with each of the effects that would do in a named one's place, or two of them at
once.

Numbers that are read from one of several rivals carry the doubt between them: their mean by
evidence, and the spread of the rivals in their interval (Hoeting et al. 1999, eq. 2 and 3).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.choice import undetermined
from imucalib.loop.evidence import Score, score
from imucalib.loop.found import FitLoop, Step
from imucalib.loop.records import extended, reduced


@dataclass(frozen=True)
class Rival:
    """One of the models that would do; weight : of all of them together, 1."""

    name: str
    weight: float
    fit: Fit


def scored_beside(fit: Fit, effects: Iterable[Effect]) -> tuple[Score, ...]:
    """Each of the effects beside a model, best first, without their chance."""
    candidates, _ = effect_candidates(fit, list(effects))
    return score(fit, candidates, np.random.default_rng(0), draws=0)


def rivals_of(loop: FitLoop) -> tuple[tuple[Rival, ...], ...]:
    """For every named effect with others beside it: itself, each of these, and any two of them, for
    what the data cannot tell apart may be there together."""
    return tuple(found for step in loop.named if len(found := _of_step(loop, step)) > 1)


@dataclass(frozen=True)
class _Taken:
    """A model with some of the effects; nats : that these gain over the model with none."""

    names: tuple[str, ...]
    nats: float
    fit: Fit


def _of_step(loop: FitLoop, step: Step) -> tuple[Rival, ...]:
    every = (step.effect, *step.aliases)
    effects = {name: effect for name in every if (effect := known(name)) is not None}
    if len(effects) < 2 or step.effect not in loop.final.model.names:
        return ()
    without = _Taken((), 0.0, reduced(loop.final, (step.effect,)))
    one = _with_each(without, tuple(effects.values()), {step.effect: loop.final})
    left = [tuple(effects[t.names[0]] for t in one[k:]) for k in range(1, len(one) + 1)]
    two = (both for taken, rest in zip(one, left, strict=True) for both in _with_each(taken, rest))
    sound = [t for t in (*one, *two) if t.fit.converged and not t.fit.null_directions]
    weights = np.exp([t.nats - max(t.nats for t in sound) for t in sound])
    each = zip(sound, weights / weights.sum(), strict=True)
    return tuple(Rival(" and ".join(t.names), float(weight), t.fit) for t, weight in each)


def _with_each(
    taken: _Taken, effects: tuple[Effect, ...], fits: Mapping[str, Fit] | None = None
) -> tuple[_Taken, ...]:
    """A model with each of the effects beside what it has, best first; fits : those that exist."""
    own, fits = {e.name: e for e in effects}, fits or {}
    return tuple(
        _Taken(
            (*taken.names, s.name),
            taken.nats + s.evidence,
            fits.get(s.name) or extended(taken.fit, own[s.name]),
        )
        for s in scored_beside(taken.fit, effects)
        if s.name in fits or not undetermined(taken.fit, own[s.name])
    )
