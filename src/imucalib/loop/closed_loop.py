"""The closed loop: residual -> evidence -> add the effect -> refit -> held-out -> stop.

Wrong records and catalogue effects compete, since each can look like the other: what explains most
goes first. Each is accepted only when its chance under "nothing missing" is small for the whole
family of candidates, an effect only when the held-out density agrees, and a record comes back when
an effect explains it. What is left is named as what it is.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, reduce

import numpy as np

from imucalib.arrays import Array
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import known
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.anytime.e_value import e_value
from imucalib.loop.candidates import effect_candidates
from imucalib.loop.choice import Decided, Options, curve_of, decided
from imucalib.loop.evidence import Score, score
from imucalib.loop.found import Checked, FitLoop, LoopSettings, Step
from imucalib.loop.noise.doubts import noise_doubts
from imucalib.loop.noise.shared import with_shared_noise
from imucalib.loop.record_errors import record_names
from imucalib.loop.records import (
    extended,
    foreseen,
    held_out_rms,
    least_strange,
    named_records,
    record_scores,
    reduced,
    row_of,
    set_aside,
)
from imucalib.loop.rivals.aliases import UNLISTED, aliases, beside, without_a_name
from imucalib.loop.rivals.exchange import exchanged
from imucalib.loop.search import choose, effect_named, search
from imucalib.loop.subject import Refused, Searched, close
from imucalib.loop.thresholds import KEEP, SUSPECTS
from imucalib.loop.unexplained import looked_like, unexplained


def close_loop(
    model: Model,
    observations: Observations,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings | None = None,
    start: Array | None = None,
    families: tuple[Family, ...] = (),
) -> FitLoop:
    """Run the search from a base model; `effects` are the catalogue's candidates.

    start : θ of the base model to start from
    families : scans over a value, for example the time of a step
    """
    rules = settings or LoopSettings()
    plain = with_shared_noise(fit_model(model, observations, start=start))
    begin = _State(
        fit=plain, records=(), steps=(), effects=effects, rng=rng, rules=rules, families=families
    )
    end = close(begin, rules)
    state = end.subject
    final = state.fit
    return FitLoop(
        base=reduce(set_aside, (row for _, row in state.records), plain),
        final=final,
        plain=plain,
        as_recorded=reduced(final, record_names(final)) if state.records else final,
        records=named_records(final, state.records),
        steps=state.steps,
        rejected=end.reasons,
        unexplained=(
            *unexplained(end.last.scores, rules),
            *looked_like(final, effects, rng, rules, end.rejected),
            *noise_doubts(final, rng, rules, shared=not state.steps, scores=end.last.scores),
        ),
        scores=end.last.scores,
        first_scores=end.first.scores,
        missing=end.last.missing,
        bar=next((s.bar for s in end.first.scores if not s.candidate.unfounded), math.inf),
    )


@dataclass(frozen=True)
class _State:
    """Where the search stands: the fit, the records that are set aside, the accepted effects."""

    fit: Fit
    records: tuple[tuple[Score, int], ...]
    steps: tuple[Step, ...]
    effects: Mapping[str, Effect]
    rng: np.random.Generator
    rules: LoopSettings
    families: tuple[Family, ...] = ()

    @property
    def _room(self) -> bool:
        return len(self.steps) < self.rules.most_effects

    @property
    def _last(self) -> str:
        return self.steps[-1].effect if self.steps else ""

    @property
    def _options(self) -> Options:
        return Options(self.effects, self.families, self.rng, self.rules)

    def search(self, rejected: Collection[str]) -> Searched:
        return search(self.fit, self.effects, self.rng, self.rules, rejected, self.families)

    def choice(self, found: Searched, rejected: Collection[str]) -> Score | None:
        return choose(found.scores, self.rules, self.fit.model.names) if self._room else None

    def cleaner(
        self, found: Searched, chosen: Score | None, rejected: Collection[str]
    ) -> _State | None:
        return self.without_the_worst_record(chosen) or (
            None if chosen else self.behind_a_record(rejected)
        )

    def tried(self, found: Searched, chosen: Score, rejected: Collection[str]) -> _State | Refused:
        taken = decided(self.fit, found.scores, chosen, self._options, self._last)
        if isinstance(taken, Refused):
            return taken
        return self.taken(taken, found.scores)

    def smoothed(self, found: Searched) -> _State | None:
        options = self._options
        smooth = curve_of(self.fit, found.scores, options, self._last) if self._room else None
        return self.taken(smooth, ()) if smooth else None

    def without_the_worst_record(self, rival: Score | None) -> _State | None:
        """Set aside the record that belongs least to the rest, if it stands out by itself and more
        than the best effect does: positions that carry an effect look like wrong records, and a
        wrong record looks like an effect."""
        best = self.suspects[:1] if len(self.records) < self.rules.most_records else ()
        if not best or best[0].p > self.rules.record_alpha or best[0].evidence <= 0.0:
            return None
        if rival is not None and rival.evidence > best[0].evidence:
            return None
        row = row_of(best[0].name)
        doubts = ((step.effect, name) for step in self.steps for name in step.aliases)
        trial = set_aside(self.fit, row)
        if not foreseen(self.fit, trial) or not self._strange(self.fit, row, doubts):
            return None
        if abs(named_records(trial, ((best[0], row),))[0].size) < self.rules.gross:
            return None
        return replace(self, fit=trial, records=(*self.records, (best[0], row)))

    def _strange(self, fit: Fit, row: int, rivals: Iterable[tuple[str, str]]) -> bool:
        """Whether a record stands out with each pair's effect replaced by what may replace it."""
        swaps = ((name, rival) for name, other in rivals if (rival := known(other)) is not None)
        p = least_strange(
            fit, row, {r for _, r in self.records}, swaps, self.rng,
            draws=self.rules.draws, alpha=self.rules.record_alpha,
        )  # fmt: skip
        return p <= self.rules.record_alpha

    @cached_property
    def suspects(self) -> tuple[Score, ...]:
        """Every record that is not set aside, worst first; scored once for a fit."""
        return self._records_of(self.fit, {row for _, row in self.records})

    def _records_of(self, fit: Fit, taken: set[int]) -> tuple[Score, ...]:
        rules = self.rules
        if fit.observations.n > rules.searchable:
            return ()
        return record_scores(fit, taken, self.rng, draws=rules.draws, alpha=rules.record_alpha)

    def taken(self, decided: Decided, scores: tuple[Score, ...]) -> _State:
        """Take an effect in, and give records back that it explains."""
        fit, chosen, curve = decided.fit, decided.score, decided.curve
        rivals = decided.rivals
        if chosen.name in {s.name for s in scores} or chosen.candidate.family:
            rivals = aliases(self.fit, self.effects, chosen, scores, self.rules) or rivals
        if not curve:
            rivals += without_a_name(self.fit, fit, chosen, self.rules.margin)
            rivals += (UNLISTED,) * any(UNLISTED in step.aliases for step in self.steps)
        step = Step(
            chosen.name,
            chosen.p,
            chosen.draws,
            chosen.evidence,
            (Checked("error", "m/s2", held_out_rms(self.fit), held_out_rms(fit)),),
            tuple(dict.fromkeys(rivals)),
            curve=curve,
            e_value=math.nan if curve else self._e_value(scores),
        )
        own = beside(self.fit, (s for s in self.steps if s.effect not in decided.drops), chosen)
        fit, own = exchanged(fit, own, extended)
        state = replace(self, fit=with_shared_noise(fit), steps=(*own, step))
        for found, row in self.records:
            without = reduced(state.fit, record_names(state.fit, row))
            others = {r for _, r in state.records if r != row}
            worst = state._records_of(without, others)[:1]
            if not worst or row_of(worst[0].name) != row or worst[0].p > self.rules.record_alpha:
                kept = tuple(r for r in state.records if r != (found, row))
                state = replace(state, fit=without, records=kept)
        return state

    def _e_value(self, scores: tuple[Score, ...]) -> float:
        """That something is missing, from all effects that could be tested."""
        single = [s.candidate for s in scores if s.candidate.kind == "effect" and not s.absorbed]
        blocks = [c.columns for c in single if not c.family]
        return e_value(self.fit, blocks, len(blocks) + len(self.families))

    def behind_a_record(self, rejected: Collection[str]) -> _State | None:
        """Where neither a record nor an effect stands out, each may hide the other.

        The most suspect records are set aside on trial. Only a pair counts: the effect must pass
        without the record, at alpha shared over the trials, and then the record beside the effect.
        """
        if len(self.records) >= self.rules.most_records or self.steps:
            return None
        strict = replace(self.rules, alpha=self.rules.alpha / SUSPECTS)
        for suspect in self.suspects[:SUSPECTS]:
            if suspect.evidence < 1.0:
                break
            row = row_of(suspect.name)
            aside = set_aside(self.fit, row)
            found = search(aside, self.effects, self.rng, strict, rejected, self.families)
            chosen = choose(found.scores, strict)
            if chosen is None:
                continue
            beside = extended(self.fit, effect_named(self.effects, chosen.name))
            again = self._records_of(beside, set())[:1]
            if not again or row_of(again[0].name) != row or again[0].p > self.rules.record_alpha:
                continue
            near = aliases(aside, self.effects, chosen, found.scores, strict)
            if self._strange(beside, row, ((chosen.name, name) for name in near)):
                return replace(self, fit=aside, records=(*self.records, (again[0], row)))
        return None

    def eliminated(self) -> _State:
        """Without an earlier effect that a later one has made unnecessary (less than 1 nat); a
        curve, which holds every shape of its driver, makes no name so."""
        state = self
        for step in self.steps[:-1]:
            curves = tuple(s.effect for s in state.steps if s.curve and not step.curve)
            without = reduced(state.fit, (step.effect, *curves))
            candidates, _ = effect_candidates(without, [effect_named(self.effects, step.effect)])
            if score(without, candidates, self.rng, draws=1)[0].evidence < KEEP:
                steps = tuple(s for s in state.steps if s.effect != step.effect)
                state = replace(state, fit=reduced(state.fit, (step.effect,)), steps=steps)
        return state
