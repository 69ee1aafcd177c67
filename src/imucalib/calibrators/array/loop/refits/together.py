"""Several steps at once, where a part of the motion is searched after the whole.

The part still chooses by itself: it takes at once what the whole ended with as far as its own first
contest shows every one beyond chance and held out, and its own joint fit needs every one beside the
others. What is doubtful in either, or has rivals, it has to find step by step.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from imucalib.calibrators.array.loop.catalogue import twins_of
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.search import Search
from imucalib.calibrators.array.loop.state import ArrayState
from imucalib.calibrators.array.loop.worth import implausible, not_held_out, refitted, worth
from imucalib.loop.evidence import Score
from imucalib.loop.thresholds import STRONG


@dataclass(frozen=True)
class Together:
    """The joint fit with all of the scores' effects as its last terms, in their order."""

    state: ArrayState
    scores: tuple[Score, ...]


def taken_together(
    found: Search, state: ArrayState, earlier: Earlier, left_out: Collection[str]
) -> Together | None:
    """Two or more of what the whole ended with; None where the part does not show so many.

    state : the same as the search's own, with its columns; left_out : effects that are not tried
    """
    if len(earlier.ended) < 2 or state.found:  # later ones answer to what was taken before
        return None
    bar = found.contest.beyond_chance(found.draws)
    by = {s.name: s for s in found.scores if s.candidate.kind == "effect" and s.evidence >= bar}
    names = (n for n in earlier.ended if n in by and n not in left_out)
    shown = tuple(by[n] for n in names if not not_held_out(found.held_out(n)))
    # The last step of a path is told from its twins where it is taken, earlier ones at its end.
    if len(shown) < 2 or twins_of(shown[-1].name):
        return None
    trial = refitted(state, earlier, *(found.term(s.name) for s in shown))
    if trial is None or not trial.converged or trial.density <= state.density:
        return None
    for score, term in zip(shown, trial.terms[-len(shown) :], strict=True):
        gyro = term.effect.channel == "angular_rate"
        left = score.evidence / shared_by_neighbours(trial, gyro=gyro)
        if left < bar or implausible(trial, term.name) or worth(trial, term) < STRONG:
            return None
    return Together(trial, shown)
