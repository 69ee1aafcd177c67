"""The array's closed loop: residual -> evidence -> add the effect -> joint refit -> held out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.calibrators.array.loop.ages import Ages, found_ages, kept_ages
from imucalib.calibrators.array.loop.asked import NOTHING_ASKED, Asked
from imucalib.calibrators.array.loop.declared import with_declared
from imucalib.calibrators.array.loop.held_out import Residuals, held_out_residuals
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.search import Search, absorbed
from imucalib.calibrators.array.loop.setup import Setup
from imucalib.calibrators.array.loop.state import ArrayState, settled, start_state, transferred
from imucalib.calibrators.array.loop.subject import MotionSubject, without_a_name
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.moving import Moving
from imucalib.loop.found import FitLoop, Loop, LoopSettings
from imucalib.loop.subject import close

ARRAY_RULES = LoopSettings(draws=499, most_effects=8)


@dataclass(frozen=True, kw_only=True)
class MotionLoop(Loop[ArrayState]):
    """The search over a motion.

    ages : clocks of the gyros, or None; before, after : held-out residuals; impact : what cannot
    be seen, with the m rms by which its typical size moves the positions; dispersion : how many
    times fewer accelerometer samples the noise that neighbours share leaves; asked : what the user
    declared; rests : the search at rest, of which `with_rests` made a part of this one
    """

    ages: Ages | None
    before: Residuals
    after: Residuals
    impact: Mapping[str, float]
    dispersion: float
    asked: Asked = NOTHING_ASKED
    rests: FitLoop | None = None


def close_array_loop(
    setup: Setup, terms: tuple[Term, ...], moving: Moving, rng: np.random.Generator,
    rules: LoopSettings = ARRAY_RULES, whole: Setup | None = None, asked: Asked = NOTHING_ASKED,
) -> MotionLoop:  # fmt: skip
    """Search, accept, refit, until nothing passes.

    whole : more samples, for the final fit alone; asked : effects that the user declares, or keeps
    out of the search
    """
    base = with_declared(start_state(setup, terms), asked.declare, moving)
    ages = found_ages(base, moving)
    before = held_out_residuals(base)
    started = base if ages is None else kept_ages(base, ages, voting=True)
    skipped = asked.skipped(setup.imus)
    first = MotionSubject(
        state=started,
        residuals=before,
        moving=moving,
        rng=rng,
        rules=rules,
        left_out=skipped,
        ages=ages,
    )
    end = close(first, rules)
    path = end.subject
    final, ages = _on_all(path, moving, whole)
    left = tuple(
        without_a_name(s)
        for s in end.last.scores
        if asked.search and s.candidate.kind != "effect" and s.p <= rules.alpha
    )
    moved = bool(path.steps or asked.declare)
    return MotionLoop(
        base=base,
        final=final,
        steps=path.steps,
        rejected=(*end.rejected.items(), *path.dropped),
        unexplained=(*path.corrected, *left[:3]),
        scores=end.last.scores,
        first_scores=end.first.scores,
        missing=end.last.missing,
        ages=ages,
        before=before,
        after=held_out_residuals(final) if moved else before,
        impact=absorbed(tuple(s for s in (end.first, end.last) if isinstance(s, Search))),
        dispersion=shared_by_neighbours(final, gyro=False),
        asked=asked,
    )


def _on_all(
    path: MotionSubject, moving: Moving, whole: Setup | None
) -> tuple[ArrayState, Ages | None]:
    """The final fit on all samples; accepted clocks with their phases from all of the motion."""
    state = path.state
    aged = any(term.aged for term in state.terms)
    if whole is None and not aged:
        return state, None
    moved = state if whole is None else transferred(state, whole)
    if not aged:
        return settled(moved), None
    again = found_ages(moved, moving, all_rows=True)
    if again is None:
        return state, path.ages
    return settled(kept_ages(moved, again, voting=False)), again
