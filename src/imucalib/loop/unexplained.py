"""What is told though nothing is taken for it: structure without a name, and effects that stand
out beyond chance and are refused."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.effects import known
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings, Step, Unexplained
from imucalib.loop.search import passes, search
from imucalib.loop.subject import Refused
from imucalib.loop.thresholds import CERTAIN, STRONG


def unexplained(scores: tuple[Score, ...], rules: LoopSettings) -> tuple[Unexplained, ...]:
    """Structure without a name that the end of a search shows."""
    left = [s for s in scores if s.p <= rules.alpha and s.candidate.kind != "effect"]
    return tuple(
        Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)
        for s in left[:3]
    )


def like(found: Score | Step, name: str, why: str) -> Unexplained:
    """Structure that an effect of that name would explain, and why it was not taken."""
    effect = known(name)
    return Unexplained(
        f"what looks like {name} and was not taken: {why}",
        driver=" and ".join(effect.needs) if effect else "",
        kind="probe",
        p=found.p,
        evidence=found.evidence,
        share=found.share if isinstance(found, Score) else 0.0,
        alike=(name,),
    )


def beyond_chance(found: Score | Step) -> bool:
    """Whether it stands out so far that it is told although other data refuse it."""
    return found.evidence > STRONG or found.p <= CERTAIN


def looked_like(
    current: Fit,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    rejected: Mapping[str, Refused],
) -> tuple[Unexplained, ...]:
    """What effects that were not taken still explain of the final fit: structure, whatever it is.

    An effect of implausible size, or one that other data refuse, names no cause; yet something is
    there. The strongest is told, with why it was not taken.
    """
    some = {name: effect for name, effect in effects.items() if name in rejected}
    if not some:
        return ()
    scores = search(current, some, rng, rules, {}).scores
    for s in scores:
        if s.name not in some or not passes(s, rules):
            continue
        # By chance some stand out that other data refuse: only strong ones are more than that.
        if beyond_chance(s) or not rejected[s.name].by_data:
            return (like(s, s.name, rejected[s.name].reason),)
    return ()
