"""The closed loop: residual -> evidence -> add the effect -> refit -> held-out -> stop.

Gross record errors first, since one wrong row hides real physics; then catalogue effects, best
first, each accepted only when its chance under "nothing missing" is small for the whole family of
candidates and the held-out density agrees; then what is left is named as what it is.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.candidates import correlated_noise, effect_candidates, probes, record_candidates
from imucalib.effect import Effect
from imucalib.effects.record_error import record_error
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.evidence import Score, score
from imucalib.fit import Fit
from imucalib.held_out import held_out, log_predictive
from imucalib.model import Model
from imucalib.observations import Observations
from imucalib.record_errors import RecordError, diagnose

Array = NDArray[np.float64]

#: An effect must gain at least this on held-out data, in log density.
_HELD_OUT_NATS = 1.0


@dataclass(frozen=True)
class LoopSettings:
    """alpha : family-wise false-alarm rate of the physics search; record_alpha : of the record
    search; margin : nats by which a probe must beat the best catalogue effect; draws : simulated
    data sets per search"""

    alpha: float = 0.04
    record_alpha: float = 0.01
    margin: float = 3.0
    draws: int = 1000
    most_effects: int = 4
    most_records: int = 4


@dataclass(frozen=True)
class Step:
    """One accepted effect. Held-out errors are rms in m/s²."""

    effect: str
    p: float
    draws: int
    evidence: float
    held_out_before: float
    held_out_after: float
    aliases: tuple[str, ...]


@dataclass(frozen=True)
class Unexplained:
    """Structure that no catalogue effect carries. share : of the weighted residual power."""

    name: str
    driver: str
    kind: str
    p: float
    evidence: float
    share: float


@dataclass(frozen=True)
class Loop:
    """The whole search.

    base, final : fits before and after; records are free in both once they are set aside
    plain, as_recorded : the base and the final model with every record taken as it stands
    scores : the last search's table; missing : why effects could not be tested
    """

    base: Fit
    final: Fit
    plain: Fit
    as_recorded: Fit
    records: tuple[RecordError, ...] = ()
    steps: tuple[Step, ...] = ()
    rejected: tuple[tuple[str, str], ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    scores: tuple[Score, ...] = ()
    first_scores: tuple[Score, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        if self.steps or self.records:
            return "explained in part" if self.unexplained else "explained"
        return "unexplained" if self.unexplained else "nothing missing"


def close_loop(
    model: Model,
    observations: Observations,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings | None = None,
    start: Array | None = None,
) -> Loop:
    """Run the search from a base model; `effects` are the catalogue's candidates.

    start : θ of the base model to start from
    """
    rules = settings or LoopSettings()
    plain = fit_model(model, observations, start=start)
    current, records = _set_records_aside(plain, (), rng, rules)
    base, steps = current, list[Step]()
    rejected: dict[str, str] = {}
    first: tuple[Score, ...] = ()
    while True:
        scores, missing = search(current, effects, rng, rules, rejected)
        first = first or scores
        chosen = _choose(scores, rules) if len(steps) < rules.most_effects else None
        if chosen is None:
            break
        trial = _extended(current, effects[chosen.name])
        reason = _why_not(current, trial)
        if reason:
            rejected[chosen.name] = reason
            continue
        steps.append(_step(current, trial, chosen, scores))
        current, records = _set_records_aside(trial, records, rng, rules)
    if records:
        base = plain
        for record in records:
            base = _extended(base, _record_effect(observations, record.row, record.channel))
    final, steps = _eliminate(current, steps, effects, rng, rules)
    return Loop(
        base,
        final,
        plain,
        _reduced(final, _record_names(final)) if records else final,
        records,
        tuple(steps),
        tuple(rejected.items()),
        _unexplained(scores, rules),
        scores,
        first,
        missing,
    )


def search(
    current: Fit,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    rejected: Mapping[str, str],
) -> tuple[tuple[Score, ...], dict[str, str]]:
    """Score everything that could be missing, and say what could not be tested."""
    usable = [e for e in effects.values() if e.name not in rejected]
    catalogue, missing = effect_candidates(current, usable)
    everything = catalogue + probes(current) + correlated_noise(current)
    return score(current, everything, rng, draws=rules.draws), missing


def _choose(scores: tuple[Score, ...], rules: LoopSettings) -> Score | None:
    """The best catalogue effect, unless a probe or noise beats it by the margin."""
    passing = [s for s in scores if s.p <= rules.alpha]
    physical = [s for s in passing if s.candidate.kind == "effect"]
    if not physical or physical[0].evidence < passing[0].evidence - rules.margin:
        return None
    return physical[0]


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
    if gain < _HELD_OUT_NATS or held_out(after).rms() >= held_out(before).rms():
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
        held_out(before).rms(),
        held_out(after).rms(),
        tuple(rivals),
    )


def _set_records_aside(
    current: Fit, known: tuple[RecordError, ...], rng: np.random.Generator, rules: LoopSettings
) -> tuple[Fit, tuple[RecordError, ...]]:
    """Free every record that cannot belong to the rest, one at a time, worst first."""
    records = known
    while len(records) < rules.most_records:
        taken = {r.row for r in records}
        candidates = [
            c for c in record_candidates(current) if int(c.name.split(":")[0]) not in taken
        ]
        best = score(current, tuple(candidates), rng, draws=rules.draws)[:1]
        if not best or best[0].p > rules.record_alpha:
            break
        row, channel = best[0].name.split(":")
        effect = _record_effect(current.observations, int(row), channel)
        trial = _extended(current, effect)
        if not trial.converged:
            break
        found = diagnose(trial, int(row), channel, best[0].p, best[0].evidence)
        current, records = trial, (*records, found)
    # A later effect sharpens what is known of a record that was set aside before it.
    refreshed = tuple(
        replace(diagnose(current, r.row, _channel_of(r), r.p, r.evidence), p=r.p) for r in records
    )
    return current, refreshed


def _channel_of(record: RecordError) -> str:
    return f"{record.channel} setting" if record.unit == "deg" else record.channel


def _record_effect(observations: Observations, row: int, channel: str) -> Effect:
    axes = channel if channel in ("x", "y", "z") else "xyz"
    return record_error(row, observations.label[row], axes)


def _record_names(fit: Fit) -> tuple[str, ...]:
    return tuple(name for name in fit.model.names if name.startswith("record_error"))


def _extended(fit: Fit, effect: Effect) -> Fit:
    """Refit with one more effect, from where the fit is."""
    return _refit(fit, fit.model.plus(effect))


def _reduced(fit: Fit, names: tuple[str, ...]) -> Fit:
    """Refit without some effects, from where the fit is."""
    return _refit(fit, Model(tuple(e for e in fit.model.effects if e.name not in names)))


def _refit(fit: Fit, model: Model) -> Fit:
    context = fit.observations.context
    start, own = model.start(context), model.slices(context)
    for name, part in fit.model.slices(context).items():
        if name in own:
            start[own[name]] = fit.theta[part]
    return fit_model(model, fit.observations, start=start)


def _eliminate(
    current: Fit,
    steps: list[Step],
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
) -> tuple[Fit, list[Step]]:
    """Drop an earlier effect that a later one has made unnecessary (less than 1 nat)."""
    for step in steps[:-1]:
        without = _reduced(current, (step.effect,))
        candidates, _ = effect_candidates(without, [effects[step.effect]])
        if score(without, candidates, rng, draws=1)[0].evidence < 1.0:
            current, steps = without, [s for s in steps if s.effect != step.effect]
    return current, steps


def _unexplained(scores: tuple[Score, ...], rules: LoopSettings) -> tuple[Unexplained, ...]:
    left = [s for s in scores if s.p <= rules.alpha and s.candidate.kind != "effect"]
    return tuple(
        Unexplained(s.name, s.candidate.driver, s.candidate.kind, s.p, s.evidence, s.share)
        for s in left[:3]
    )
