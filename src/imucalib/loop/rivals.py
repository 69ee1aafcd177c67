"""What else would do: the final model with one effect exchanged for each that may replace it.

Numbers that are read from one of several rivals carry the doubt between them: their mean by
evidence, and the spread of the rivals in their interval (Hoeting et al. 1999, eq. 2 and 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.evidence import score
from imucalib.loop.found import FitLoop, Step
from imucalib.loop.records import extended, reduced


@dataclass(frozen=True)
class Rival:
    """One of the models that would do; weight : of all of them together, 1."""

    name: str
    weight: float
    fit: Fit


def rivals_of(loop: FitLoop) -> tuple[tuple[Rival, ...], ...]:
    """For every named effect with others beside it, itself and these."""
    return tuple(found for step in loop.named if len(found := _of_step(loop, step)) > 1)


def _of_step(loop: FitLoop, step: Step) -> tuple[Rival, ...]:
    effects = [e for name in (step.effect, *step.aliases) if (e := known(name)) is not None]
    if len(effects) < 2 or step.effect not in loop.final.model.names:
        return ()
    without = reduced(loop.final, (step.effect,))
    candidates, _ = effect_candidates(without, effects)
    nothing_drawn = np.random.default_rng(0)
    scores = score(without, candidates, nothing_drawn, draws=0)
    nats = {s.name: s.evidence for s in scores}
    best = max(nats.values())
    found = []
    for effect in effects:
        if effect.name not in nats:
            continue
        fit = loop.final if effect.name == step.effect else extended(without, effect)
        if fit.converged and not fit.null_directions:
            found.append((effect.name, float(np.exp(nats[effect.name] - best)), fit))
    total = sum(weight for _, weight, _ in found)
    return tuple(Rival(name, weight / total, fit) for name, weight, fit in found)
