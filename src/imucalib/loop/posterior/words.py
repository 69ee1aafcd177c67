"""What the posterior says, in names and probabilities.

Something is missing where the base model is unlikely. Told is the simplest set that the best does
not beat by more than chance (Occam's window); in each of its places stands everything that could,
with its share. A name is certain where it is in nearly all of the posterior, and no free function
or unnamed law is likelier than not to stand in for what it leaves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.loop.posterior.odds import CERTAIN, COMPLETE, TOLD
from imucalib.loop.posterior.problem import Contest
from imucalib.loop.posterior.space import Hypothesis, Posterior
from imucalib.loop.posterior.tried import of_each


@dataclass(frozen=True)
class Place:
    """One thing that is missing.

    component : that is told; probability : that it is there, in its place or beside others
    rivals : (component, share of this place) of all that could stand there, likeliest first, until
        they are 95 %; certain : whether it is a cause beyond doubt
    """

    component: int
    probability: float
    rivals: tuple[tuple[int, float], ...]
    certain: bool

    @property
    def log_odds(self) -> float:
        """Nats in favour of its being there."""
        odds = self.probability / max(1.0 - self.probability, 1e-12)
        return float(np.log(max(odds, 1e-12)))


@dataclass(frozen=True)
class Told:
    """complete : probability that nothing is missing; hypothesis : the set that is told and
    corrected; places : its components, likeliest first"""

    complete: float
    hypothesis: Hypothesis
    places: tuple[Place, ...]


def told(problem: Contest, posterior: Posterior, *, names_first: bool = False) -> Told:
    """The words of a posterior.

    names_first : whether a set of names is told before one of its size that has no name in it, and
        does not beat it by more than chance: where what has no name is not corrected
    """
    pairs = list(zip(posterior.hypotheses, posterior.probability, strict=True))
    complete = float(sum(p for h, p in pairs if not h.components))
    if complete >= COMPLETE:
        return Told(complete, posterior.base, ())
    bar = np.exp(-TOLD) * posterior.probability[0]
    said = min(
        ((h, p) for h, p in pairs if p > bar and h.components),
        key=lambda pair: (
            len(pair[0].components),
            names_first and sum(not problem.components[c].named for c in pair[0].components),
            -pair[1],
        ),
    )[0]
    inside = of_each(posterior, len(problem.components))[1]
    nameless = sum(
        p for h, p in pairs if any(not problem.components[c].named for c in h.components)
    )
    places = []
    for component in said.components:
        rivals = _rivals(posterior, said, component)
        likely = float(inside[component])
        alone = len(rivals) == 1 and likely > CERTAIN and nameless < 0.5
        sure = bool(alone and problem.components[component].named)
        places.append(Place(component, likely, rivals, sure))
    return Told(complete, said, tuple(sorted(places, key=lambda p: -p.probability)))


def name_of(problem: Contest, posterior: Posterior, said: Told, component: int) -> str:
    """The effect that stands for a component in what is told, or in its likeliest set."""
    sets = (said.hypothesis, *posterior.hypotheses)
    own = next(h for h in sets if component in h.components)
    picked = (problem.choices[p.choice] for p in own.picks)
    return next(choice.member.name for choice in picked if choice.component == component)


def _rivals(
    posterior: Posterior, said: Hypothesis, component: int
) -> tuple[tuple[int, float], ...]:
    """What stands in a component's place in sets that have all the others."""
    rest = set(said.components) - {component}
    weight: dict[int, float] = {}
    for hypothesis, p in zip(posterior.hypotheses, posterior.probability, strict=True):
        own = set(hypothesis.components)
        if len(own) == len(said.components) and rest <= own:
            other = (own - rest).pop()
            weight[other] = weight.get(other, 0.0) + float(p)
    total, told_of, so_far = sum(weight.values()), [], 0.0
    for other in sorted(weight, key=lambda c: -weight[c]):
        told_of.append((other, weight[other] / total))
        so_far += weight[other] / total
        if so_far > CERTAIN:
            break
    return tuple(told_of)
