"""Where the array's loop stands, as the shared loop asks it.

Everything that could be missing stands in one contest with one false-alarm rate. What wins must
realise its gain in the joint fit of positions, effects and motion, and both held-out halves of the
motion must agree. A curve without a name that explains much more than the best effect has to be
matched by at most three effects together; otherwise they are put back and the curve is reported.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.calibrators.array.loop.ages import Ages, ages_again, kept_ages
from imucalib.calibrators.array.loop.catalogue import twins_of
from imucalib.calibrators.array.loop.curves import CURVE
from imucalib.calibrators.array.loop.earlier import Earlier
from imucalib.calibrators.array.loop.held_out import Residuals, held_out_residuals
from imucalib.calibrators.array.loop.noise_tests import shared_by_neighbours
from imucalib.calibrators.array.loop.refits.shared_lag import with_shared_first
from imucalib.calibrators.array.loop.refits.together import taken_together
from imucalib.calibrators.array.loop.refits.twins import told_apart
from imucalib.calibrators.array.loop.search import Search, search
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.worth import (
    not_held_out,
    refitted,
    shared_noise,
    size_in_words,
    why_not,
    worth,
)
from imucalib.calibrators.array.moving import Moving
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings, Step, Unexplained
from imucalib.loop.subject import Refused, Searched
from imucalib.loop.thresholds import CURVES, KEEP, PATH


@dataclass(frozen=True)
class MotionSubject:
    """Where the search stands. debt : nats that effects still have to explain because a curve
    explained them, since `safe`; taken : how many effects tried to; left_out : what is not tried,
    by the user's wish or because it was refused before this state; lost : twins of what was taken
    whose fits are lost, with its nats; matched : curves that effects
    took the place of, and the path before; corrected : structure without a name that a curve takes
    out; clocks : whether the gyros' clocks may be looked for again; over : whether effects were put
    back, which ends the search for them"""

    state: ArrayState
    residuals: Residuals
    moving: Moving
    rng: np.random.Generator
    rules: LoopSettings
    left_out: frozenset[str]
    ages: Ages | None
    earlier: Earlier
    lost: tuple[tuple[str, float], ...] = ()
    steps: tuple[Step, ...] = ()
    dropped: tuple[tuple[str, str], ...] = ()
    debt: float = 0.0
    taken: int = 0
    safe: MotionSubject | None = None
    matched: tuple[tuple[str, MotionSubject], ...] = ()
    corrected: tuple[Unexplained, ...] = ()
    clocks: bool = True
    over: bool = False

    @cached_property
    def searched(self) -> Search:
        """What could be missing; refusing an effect moves nothing that the others are scored by."""
        return search(self.state, self.left_out, self.rng, self.rules.draws, self.earlier)

    def search(self, rejected: Collection[str]) -> Search:
        return self.searched

    def choice(self, found: Searched, rejected: Collection[str]) -> Score | None:
        """The best effect; where a curve leads by more than the margin, still the best effect."""
        curved = any(step.curve for step in self.steps)
        if self.over or curved or len(self.steps) >= self.rules.most_effects or self.taken >= PATH:
            return None
        left_out = self.left_out.union(rejected)
        passing = (
            s for s in self.searched.passing(self.rules.alpha)
            if s.candidate.kind == "effect" and s.name not in left_out
        )  # fmt: skip
        return next(passing, None)

    def cleaner(
        self, found: Searched, chosen: Score | None, rejected: Collection[str]
    ) -> MotionSubject | None:
        """Clocks that other gyro effects had hidden; or, where effects did not take the place of a
        curve, the path without them."""
        if chosen is not None or self.over or any(step.curve for step in self.steps):
            return None
        again = ages_again(self.state, self.moving, self.ages) if self.clocks else None
        if again is not None:
            state = kept_ages(self.state, again, voting=True)
            return replace(self, state=state, ages=again, clocks=False)
        back = self.safe or _matched_in_vain(self, self.rules.alpha)
        if back is None:
            return None
        put_back = replace(back, ages=self.ages, clocks=False, over=True)
        # At the same state: what could be missing is known.
        put_back.__dict__["searched"] = back.searched
        return put_back

    def tried(
        self, found: Searched, chosen: Score, rejected: Collection[str]
    ) -> MotionSubject | Refused:
        reason = not_held_out(self.searched.held_out(chosen.name))
        if reason:  # before the refit: it is what a search costs most
            return Refused(chosen.name, reason)
        late = self.searched.by_chance(chosen, self.searched.shared(chosen.name, self.state))
        if late.p > self.rules.alpha:
            return Refused(chosen.name, shared_noise(late.p))
        left_out = self.left_out.union(rejected)
        several = taken_together(self.searched, self.state, self.earlier, left_out)
        if several is not None:
            grown = self._with(several.state, *several.scores)
            return self._owing(grown, several.scores[0], rejected)
        chosen, tried = with_shared_first(self.searched, chosen, self.earlier, left_out, self.rules)
        if tried.state is None:
            return Refused(chosen.name, tried.reason)
        gyro = tried.state.terms[-1].effect.channel == "angular_rate"
        factor = shared_by_neighbours(tried.state, gyro=gyro)
        late = self.searched.by_chance(chosen, factor)
        if late.p > self.rules.alpha:
            return Refused(chosen.name, shared_noise(late.p))
        left_out = left_out.union(*(twins_of(name) for name in rejected))
        grown = self._with(tried.state, chosen, twins=tried.rivals)
        lost = ((name, chosen.evidence) for name in tried.lost)
        grown = replace(grown, left_out=left_out, lost=(*self.lost, *lost))
        return self._owing(grown, chosen, rejected)

    def _with(
        self, trial: ArrayState, *scores: Score, twins: tuple[str, ...] = ()
    ) -> MotionSubject:
        """With more steps, whose effects are the last terms of the trial, in their order; twins :
        that would do as well."""
        after = held_out_residuals(trial)
        steps = tuple(
            Step(
                effect=term.name,
                p=chosen.p,
                draws=chosen.draws,
                evidence=chosen.evidence,
                checked=self.residuals.against(after),
                aliases=(*twins, *self.searched.aliases(chosen), *self._would_leave(chosen)),
                value=size_in_words(trial, term),
                gains=self.searched.held_out(chosen.name),
                curve=chosen.candidate.kind != "effect",
            )
            for term, chosen in zip(trial.terms[-len(scores) :], scores, strict=True)
        )
        return replace(self, state=trial, residuals=after, steps=(*self.steps, *steps))

    def _would_leave(self, chosen: Score) -> tuple[str, ...]:
        """What a smaller effect could be of twins whose fits are lost: nothing is known of it."""
        return tuple(f"what {name} would leave" for name, own in self.lost if own > chosen.evidence)

    def _owing(
        self, grown: MotionSubject, chosen: Score, rejected: Collection[str]
    ) -> MotionSubject:
        """The grown path with the account of what a leading curve has explained."""
        leader = next(
            s for s in self.searched.scores
            if s.candidate.kind != "noise" and s.name not in self.left_out.union(rejected)
        )  # fmt: skip
        gained = grown.state.density - self.state.density
        if self.safe is None:
            if leader.candidate.kind == "effect":
                return grown
            before = self.aside()
            grown = replace(grown, matched=(*self.matched, (leader.name, before)))
            if leader.evidence <= chosen.evidence + self.rules.margin:
                return grown
            grown = replace(grown, safe=before, debt=leader.evidence - self.rules.margin)
        debt = grown.debt - gained
        if debt <= 0.0:
            return replace(grown, safe=None, debt=0.0, taken=0)
        return replace(grown, debt=debt, taken=grown.taken + 1)

    def aside(self) -> MotionSubject:
        """This path to come back to, with its search, without the columns and products of its fit:
        of many IMUs they are large."""
        aside = replace(self, state=replace(self.state))
        if "searched" in self.__dict__:
            aside.__dict__["searched"] = self.searched
        return aside

    def smoothed(self, found: Searched) -> MotionSubject | None:
        if sum(step.curve for step in self.steps) >= CURVES:
            return None
        seen = self.searched
        probes = (s for s in seen.passing(self.rules.alpha) if seen.correctable(s.name))
        chosen = next(probes, None)
        if chosen is None:
            return None
        gains, term = seen.held_out(chosen.name), seen.term(chosen.name)
        term = replace(term, name=CURVE + term.name)
        if min(gains) <= 0.0:
            return None
        trial = refitted(self.state, self.earlier, term)
        if trial is None or why_not(self.state, trial):
            return None
        corrected = (*self.corrected, without_a_name(chosen))
        return replace(self._with(trial, chosen), corrected=corrected)

    def eliminated(self) -> MotionSubject:
        path = self._told_apart()
        # A twin in the place of another may leave nothing of the last step either.
        same = [s.effect for s in path.steps] == [s.effect for s in self.steps]
        for step in path.steps[:-1] if same else path.steps:
            term = next(t for t in path.state.terms if t.name == step.effect)
            if worth(path.state, term) >= KEEP:
                continue
            left = tuple(t for t in path.state.terms if t.name != step.effect)
            path = replace(
                path,
                state=settled(replace(path.state, terms=left)),
                steps=tuple(s for s in path.steps if s.effect != step.effect),
                dropped=(*path.dropped, (step.effect, "made unnecessary by later effects")),
            )
        return path

    def _told_apart(self) -> MotionSubject:
        """Every step but the last as the one of its twins that fits best beside all that was found
        after it."""
        path = self
        for k, step in enumerate(self.steps[:-1]):
            twins = [twin for twin in twins_of(step.effect) if twin not in self.left_out]
            if not twins:
                continue
            state, name, rivals = told_apart(path.state, step.effect, twins, self.rules.margin)
            term = next(t for t in state.terms if t.name == name)
            others = (a for a in step.aliases if a not in {step.effect, *twins})
            told = replace(
                step, effect=name, value=size_in_words(state, term), aliases=(*rivals, *others)
            )
            steps = (*path.steps[:k], told, *path.steps[k + 1 :])
            path = replace(path, state=state, steps=steps)
        return path


def _matched_in_vain(path: MotionSubject, alpha: float) -> MotionSubject | None:
    """Where the path stood before effects took the place of a curve that still stands out."""
    if not path.matched:
        return None
    passing = {s.name for s in path.searched.passing(alpha)}
    return next((before for curve, before in path.matched if curve in passing), None)


def without_a_name(s: Score) -> Unexplained:
    return Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)
