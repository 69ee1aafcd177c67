"""The array's closed loop: residual -> evidence -> add the effect -> joint refit -> held out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibrators.array.estimate.covariance import with_uneven
from imucalib.calibrators.array.estimate.every import fitted_on_all, on_all, settled_there
from imucalib.calibrators.array.estimate.uneven import POSITIONS, Uneven
from imucalib.calibrators.array.loop.ages import Ages, found_ages, kept_ages
from imucalib.calibrators.array.loop.asked import NOTHING_ASKED, Asked
from imucalib.calibrators.array.loop.cross_fit import Gained, cross_fitted
from imucalib.calibrators.array.loop.declared import with_declared
from imucalib.calibrators.array.loop.earlier import Earlier, drawn_state
from imucalib.calibrators.array.loop.held_out import held_out_residuals
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.search import Search, absorbed
from imucalib.calibrators.array.loop.setup import Setup
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.subject import MotionSubject, without_a_name
from imucalib.calibrators.array.loop.terms import Term
from imucalib.calibrators.array.moving import Moving
from imucalib.loop.found import FitLoop, Loop, LoopSettings, Step, Unexplained
from imucalib.loop.subject import End, close
from imucalib.loop.thresholds import STRONG

HALF_DRAWS = 99  # simulated data sets of a half's search: enough for the rate of false alarms
_REFUSED = "motion that took no part in the search refuses it"
ARRAY_RULES = LoopSettings(draws=499, most_effects=8, curves=False)


@dataclass(frozen=True, kw_only=True)
class MotionLoop(Loop[ArrayState]):
    """The search over a motion.

    ages : clocks of the gyros, or None; gained : what motion that took no part in any choice says,
    None where it is too short for that; impact : what cannot
    be seen, with the m rms by which its typical size moves the positions; dispersion : how many
    times fewer accelerometer samples the noise that neighbours share leaves; asked : what the user
    declared; rests : the search at rest, of which `with_rests` made a part of this one
    """

    ages: Ages | None
    gained: Gained | None
    impact: Mapping[str, float]
    moved: Mapping[str, float]
    dispersion: float
    asked: Asked = NOTHING_ASKED
    rests: FitLoop | None = None

    @property
    def suspected(self) -> bool:
        """Whether the motion names a cause that the other half of it does not prove."""
        own = self.rests.steps if self.rests is not None else ()
        in_motion = len(self.named) > len(own)
        return in_motion and self.gained is not None and not self.gained.proved


def close_array_loop(
    setup: Setup, terms: tuple[Term, ...], moving: Moving, rng: np.random.Generator,
    rules: LoopSettings = ARRAY_RULES, halved: Setup | None = None, most: int | None = None,
    asked: Asked = NOTHING_ASKED,
) -> MotionLoop:  # fmt: skip
    """Search, accept, refit, until nothing passes; then the same on each half of the motion.

    halved : more samples for the halves; most : of all informative ones, how many the final fit
    takes, or None for those of the search; asked : effects that the user declares, or keeps out of
    the search
    """
    earlier = Earlier()

    def started(chosen: Setup) -> MotionSubject:
        return _start(chosen, terms, moving, rng, rules, asked=asked, earlier=earlier)

    def searched(chosen: Setup) -> tuple[MotionSubject, MotionSubject]:
        first = started(chosen)
        few = replace(rules, draws=min(rules.draws, HALF_DRAWS))
        if not asked.search:
            return first, first
        return first.aside(), close(replace(first, rules=few), few).subject.aside()

    first = started(setup)
    end = close(first, rules)
    first, path = first.aside(), end.subject.aside()
    end = replace(end, subject=path)
    earlier.ended = tuple(s.effect for s in path.steps if not (s.curve or s.aliases))
    gained = cross_fitted(halved or setup, moving, searched)
    refused: tuple[tuple[str, str], ...] = ()
    structure = path.corrected
    if path.steps and gained is not None and gained.refutes:
        refused = tuple((step.effect, _REFUSED) for step in path.steps)
        structure += tuple(_as_structure(step) for step in path.steps if step.evidence > STRONG)
        path = first
    final, ages = _on_all(path, moving, most)
    dispersion = shared_by_neighbours(final, gyro=False)
    final, apart = with_uneven(final, dispersion)
    end, left = _left(end, rules.alpha)
    return _ended(
        end, path,
        base=first.state,
        final=final,
        unexplained=(*structure, *(left[:3] if asked.search else ())),
        refused=refused,
        ages=ages,
        gained=gained,
        dispersion=dispersion,
        asked=asked,
        apart=apart,
    )  # fmt: skip


def _as_positions(apart: Uneven) -> Unexplained:
    name = POSITIONS + apart.driver
    return Unexplained(name, apart.driver, "probe", apart.p, apart.nats, 0.0)


def _left(
    end: End[MotionSubject], alpha: float
) -> tuple[End[MotionSubject], tuple[Unexplained, ...]]:
    """The end with every p of its last search, and what still stands out there without a name."""
    last = end.last
    assert isinstance(last, Search)
    scores = last.drawn
    left = (s for s in scores if s.candidate.kind != "effect" and s.p <= alpha)
    told = tuple(without_a_name(s) for s in left)
    return replace(end, last=replace(last, scores=scores)), told


def _ended(
    end: End[MotionSubject], path: MotionSubject, *, base: ArrayState, final: ArrayState,
    unexplained: tuple[Unexplained, ...], refused: tuple[tuple[str, str], ...],
    ages: Ages | None, gained: Gained | None, dispersion: float, asked: Asked,
    apart: Uneven | None,
) -> MotionLoop:  # fmt: skip
    searches = tuple(s for s in (end.first, end.last) if isinstance(s, Search))
    moved = {
        u.name: max((s.moves(u.name) for s in searches[-1:]), default=0.0) for u in unexplained
    }
    if apart is not None:
        unexplained = (_as_positions(apart), *unexplained)
        moved[unexplained[0].name] = float(apart.spread.max())
    return MotionLoop(
        base=base,
        final=final,
        steps=path.steps,
        rejected=(*end.reasons, *path.dropped, *refused),
        refuted=tuple(name for name, _ in refused),
        unexplained=unexplained,
        scores=end.last.scores,
        first_scores=end.first.scores,
        missing=end.last.missing,
        difference=None if gained is None else gained.principal,
        ages=ages,
        gained=gained,
        impact=absorbed(searches),
        moved=moved,
        dispersion=dispersion,
        asked=asked,
    )


def _start(
    setup: Setup, terms: tuple[Term, ...], moving: Moving, rng: np.random.Generator,
    rules: LoopSettings, *, asked: Asked, earlier: Earlier,
) -> MotionSubject:  # fmt: skip
    """The base model on some samples, with the clocks that it shows."""
    start = settled(earlier.begun(drawn_state(setup, terms)))
    base = with_declared(earlier.kept(start), asked.declare, moving)
    ages = found_ages(base, moving)
    return MotionSubject(
        state=base if ages is None else kept_ages(base, ages, voting=True),
        residuals=held_out_residuals(base),
        moving=moving,
        rng=rng,
        rules=rules,
        left_out=asked.skipped(setup.imus),
        ages=ages,
        earlier=earlier,
    )


def _as_structure(step: Step) -> Unexplained:
    """A step that held-out motion refuses, as structure that has no name."""
    return Unexplained(step.effect, step.effect, "effect", step.p, step.evidence, 0.0)


def _on_all(
    path: MotionSubject, moving: Moving, most: int | None
) -> tuple[ArrayState, Ages | None]:
    """The final fit on all samples; accepted clocks with their phases from all of the motion."""
    state = path.state
    if not any(term.aged for term in state.terms):
        return (state if most is None else fitted_on_all(state, moving, most)), None
    moved = state if most is None else on_all(state, moving, most)
    again = found_ages(moved, moving, all_rows=True)
    if again is None:
        return state, path.ages
    return settled_there(kept_ages(moved, again, voting=False)), again
