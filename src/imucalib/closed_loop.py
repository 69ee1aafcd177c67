"""The closed loop: residual -> evidence -> add the effect -> refit -> held-out -> stop.

Gross record errors first, since one wrong row hides real physics; then catalogue effects, best
first, each accepted only when its chance under "nothing missing" is small for the whole family of
candidates and the held-out density agrees; then what is left is named as what it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from imucalib.candidates import effect_candidates
from imucalib.effect import Effect, Family
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.evidence import Score, score
from imucalib.fit import Fit
from imucalib.held_out import log_predictive
from imucalib.loop import Loop, LoopSettings, Step
from imucalib.loop_records import (
    extended,
    held_out_rms,
    named_records,
    record_names,
    record_scores,
    reduced,
    row_of,
    set_aside,
)
from imucalib.loop_search import choose, effect_named, refined, search, unexplained
from imucalib.model import Model
from imucalib.observations import Observations

Array = NDArray[np.float64]

#: An effect must gain at least this on held-out data, in log density.
_HELD_OUT_NATS = 1.0
#: Suspect records that are set aside on trial when nothing stands out by itself.
_SUSPECTS = 3


def close_loop(
    model: Model,
    observations: Observations,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings | None = None,
    start: Array | None = None,
    families: tuple[Family, ...] = (),
) -> Loop:
    """Run the search from a base model; `effects` are the catalogue's candidates.

    start : θ of the base model to start from
    families : scans over a value, for example the time of a step
    """
    rules = settings or LoopSettings()
    plain = fit_model(model, observations, start=start)
    state = _State(plain, (), (), rng, rules, families).without_wrong_records()
    rejected: dict[str, str] = {}
    first: tuple[Score, ...] = ()
    while True:
        scores, missing = search(state.fit, effects, rng, rules, rejected, families)
        first = first or scores
        chosen = choose(scores, rules) if len(state.steps) < rules.most_effects else None
        if chosen is None:
            freed = state.behind_a_record(effects, rejected)
            if freed is None:
                break
            state = freed
            continue
        chosen = refined(state.fit, chosen, families, rng, rules)
        trial = extended(state.fit, effect_named(effects, chosen.name))
        reason = _why_not(state.fit, trial)
        if reason:
            rejected[chosen.candidate.family or chosen.name] = reason
            continue
        state = state.accept(trial, _step(state.fit, trial, chosen, scores))
    final, steps = _eliminate(state, effects)
    return Loop(
        base=reduce(set_aside, (row for _, row in state.records), plain),
        final=final,
        plain=plain,
        as_recorded=reduced(final, record_names(final)) if state.records else final,
        records=named_records(final, state.records),
        steps=steps,
        rejected=tuple(rejected.items()),
        unexplained=unexplained(scores, rules),
        scores=scores,
        first_scores=first,
        missing=missing,
    )


@dataclass(frozen=True)
class _State:
    """Where the search stands: the fit, the records that are set aside, the accepted effects."""

    fit: Fit
    records: tuple[tuple[Score, int], ...]
    steps: tuple[Step, ...]
    rng: np.random.Generator
    rules: LoopSettings
    families: tuple[Family, ...] = ()

    def without_wrong_records(self) -> _State:
        """Set aside every record that cannot belong to the rest, one at a time, worst first."""
        state = self
        if self.fit.observations.n > self.rules.searchable:
            return state
        while len(state.records) < state.rules.most_records:
            best = state.scored_records()[:1]
            if not best or best[0].p > state.rules.record_alpha:
                break
            row = row_of(best[0].name)
            trial = set_aside(state.fit, row)
            if not trial.converged:
                break
            state = replace(state, fit=trial, records=(*state.records, (best[0], row)))
        return state

    def scored_records(self) -> tuple[Score, ...]:
        return self._records_of(self.fit, {row for _, row in self.records})

    def _records_of(self, fit: Fit, taken: set[int]) -> tuple[Score, ...]:
        rules = self.rules
        return record_scores(fit, taken, self.rng, draws=rules.draws, alpha=rules.record_alpha)

    def accept(self, fit: Fit, step: Step) -> _State:
        """Take an effect in, and look at the records again: it may have hidden one."""
        return replace(self, fit=fit, steps=(*self.steps, step)).without_wrong_records()

    def behind_a_record(
        self, effects: Mapping[str, Effect], rejected: Mapping[str, str]
    ) -> _State | None:
        """Where neither a record nor an effect stands out, each may hide the other.

        The most suspect records are set aside on trial. Only a pair counts: the effect must pass
        without the record, at alpha shared over the trials, and then the record beside the effect.
        """
        if len(self.records) >= self.rules.most_records or self.steps:
            return None
        if self.fit.observations.n > self.rules.searchable:
            return None
        strict = replace(self.rules, alpha=self.rules.alpha / _SUSPECTS)
        for suspect in self.scored_records()[:_SUSPECTS]:
            if suspect.evidence < 1.0:
                break
            row = row_of(suspect.name)
            aside = set_aside(self.fit, row)
            scores, _ = search(aside, effects, self.rng, strict, rejected, self.families)
            chosen = choose(scores, strict)
            if chosen is None:
                continue
            beside = extended(self.fit, effect_named(effects, chosen.name))
            again = self._records_of(beside, set())[:1]
            if again and row_of(again[0].name) == row and again[0].p <= self.rules.record_alpha:
                return replace(self, fit=aside, records=(*self.records, (again[0], row)))
        return None


def _why_not(before: Fit, after: Fit) -> str:
    """Empty when the refit realises the gain and the held-out density agrees."""
    if not after.converged:
        return "its refit did not converge"
    if len(after.null_directions) > len(before.null_directions):
        return f"the data cannot determine it: {after.null_directions[-1]}"
    implausible = [
        f"{p.name} = {v:.3g} {p.unit}"
        for p, v in zip(after.parameters, after.theta, strict=True)
        if abs(v) > p.plausible
    ]
    if implausible:
        return f"implausible size ({', '.join(implausible)})"
    if len(after.theta) * 1.5 > after.at.residual.size:
        return "too few numbers for its parameters"
    gain = log_predictive(after) - log_predictive(before)
    if gain < _HELD_OUT_NATS or held_out_rms(after) >= held_out_rms(before):
        return f"it does not hold out: {gain:+.1f} nats on data that it was not fitted to"
    return ""


def _step(before: Fit, after: Fit, chosen: Score, scores: tuple[Score, ...]) -> Step:
    near = max(chosen.evidence - 3.0, chosen.evidence / 2.0)
    rivals = [
        s.name
        for s in scores
        if s.candidate.kind == "effect" and s.name != chosen.name and s.evidence >= near
    ]
    return Step(
        chosen.name,
        chosen.p,
        chosen.draws,
        chosen.evidence,
        held_out_rms(before),
        held_out_rms(after),
        tuple(rivals),
    )


def _eliminate(state: _State, effects: Mapping[str, Effect]) -> tuple[Fit, tuple[Step, ...]]:
    """Drop an earlier effect that a later one has made unnecessary (less than 1 nat)."""
    current, steps = state.fit, state.steps
    for step in steps[:-1]:
        without = reduced(current, (step.effect,))
        candidates, _ = effect_candidates(without, [effect_named(effects, step.effect)])
        if score(without, candidates, state.rng, draws=1)[0].evidence < 1.0:
            current, steps = without, tuple(s for s in steps if s.effect != step.effect)
    return current, steps
