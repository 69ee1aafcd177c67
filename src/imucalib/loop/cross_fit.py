"""Before and after on data that took no part in the choice: the search itself is repeated.

An effect that was chosen on all data has seen what a leave-one-out error calls held out. Here each
fold is predicted by a model that was searched for and fitted without it. The evidence that a
candidate must reach is that of the whole search, so no new data need to be simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.effects.shape import is_form
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.choice import Decided, Options, curve_of, decided
from imucalib.loop.design import Fold, parts_of
from imucalib.loop.difference import Metric, difference, with_density
from imucalib.loop.evidence import Score
from imucalib.loop.foretold import foretold
from imucalib.loop.found import FitLoop, LoopSettings, Step
from imucalib.loop.held_out import Held, errors, theta_without, without_records
from imucalib.loop.record_errors import record_names
from imucalib.loop.rivals.aliases import aliases
from imucalib.loop.rivals.exchange import exchanged
from imucalib.loop.search import choose, search
from imucalib.loop.subject import Refused
from imucalib.loop.unexplained import beyond_chance, like
from imucalib.units import MG


@dataclass(frozen=True)
class CrossFit:
    """Held-out predictions of the base model and of the searched one, by the same folds: with every
    record as it stands, as the calibration is made, and with the wrong ones set aside, as the gain
    of an effect is judged; nats : (K,) of log density that the search gains in each fold."""

    folds: tuple[Fold, ...]
    before: Held
    after: Held
    clean_before: Held
    clean_after: Held
    nats: Array


def cross_fitted(
    loop: FitLoop,
    folds: tuple[Fold, ...],
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings,
    families: tuple[Family, ...] = (),
) -> CrossFit:
    """Repeat the search without each fold."""
    rules = replace(settings, bar=loop.bar)
    wrong = tuple(r.row for r in loop.records)
    data = loop.plain.observations
    after, clean, nats = [], [], []
    every = np.arange(data.n)
    for fold in folds:
        held, good = data.take(fold.rows), _without(fold, wrong)
        plain = theta_without(loop.base, np.setdiff1d(every, fold.rest))
        chosen = _searched(loop, good.rest, effects, rng, rules, families, theta=plain)
        found = len(chosen.model.names) > len(loop.plain.model.names)
        whole = loop.final.observations if found else data
        clean.append(errors(chosen, chosen.theta, held))
        nats.append(
            foretold(chosen, chosen.theta, whole, good) - foretold(loop.base, plain, data, good)
        )
        after.append(clean[-1] if not wrong else _as_recorded(chosen, whole, fold))
    before, late = by_folds(loop.plain, folds), _joined(after, folds)
    if not wrong:
        return CrossFit(folds, before, late, before, late, np.array(nats))
    base = by_folds(loop.base, folds)
    return CrossFit(folds, before, late, base, _joined(clean, folds), np.array(nats))


def by_folds(fit: Fit, folds: tuple[Fold, ...]) -> Held:
    """Held-out predictions of a model that nothing was chosen for."""
    data = fit.observations
    every = np.arange(data.n)
    parts = []
    for fold in folds:
        theta = without_records(fit, theta_without(fit, np.setdiff1d(every, fold.rest)))
        parts.append(errors(fit, theta, data.take(fold.rows)))
    return _joined(parts, folds)


def judged(loop: FitLoop, held: CrossFit, metric: Metric) -> FitLoop:
    """The loop with the word of data that took no part: the difference, and nothing taken where the
    error there has not fallen. Records that are wrong prove nothing for or against an effect."""
    good = np.setdiff1d(np.arange(loop.plain.observations.n), [r.row for r in loop.records])
    sizes = held.clean_before.size[good], held.clean_after.size[good]
    found = difference(*sizes, parts_of(held.folds)[good], len(held.folds), metric)
    if loop.plain.at.settings:
        found = with_density(found, held.nats)
    if found.holds:
        return replace(loop, difference=found)
    why = f"on data that took no part the error is {found.before / MG:.3g} mg without it, "
    why += f"{found.after / MG:.3g} with it"
    strong = tuple(like(s, s.effect, why) for s in loop.named if beyond_chance(s))
    return replace(
        loop,
        final=loop.base,
        as_recorded=loop.plain,
        steps=(),
        rejected=(*loop.rejected, *((s.effect, why) for s in loop.steps)),
        refuted=tuple(s.effect for s in loop.steps),
        unexplained=(*loop.unexplained, *strong),
        difference=found,
    )


def _without(fold: Fold, wrong: tuple[int, ...]) -> Fold:
    return Fold(np.setdiff1d(fold.rows, wrong), np.setdiff1d(fold.rest, wrong), fold.stretch)


def _as_recorded(chosen: Fit, data: Observations, fold: Fold) -> Held:
    """The fold predicted by the chosen model, fitted to all of the rest as it stands."""
    rest = data.take(fold.rest)
    fit = fit_model(chosen.model, rest, start=chosen.theta, noise=chosen.noise)
    return errors(fit, fit.theta, data.take(fold.rows))


def _searched(
    loop: FitLoop,
    rest: Index,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    families: tuple[Family, ...],
    *,
    theta: Array,
) -> Fit:
    """The loop on a part of the data that has no wrong record; theta : of the base model there, to
    first order. The noise is that of the whole, before and after: it costs most of the time and
    tells nothing about the choice. In between it is estimated: one of two effects leaves the
    other."""
    plain = loop.plain
    options = Options(
        effects, families, rng, rules, noise=loop.final.noise,
        data=loop.final.observations.take(rest), terms=_terms(loop.final),
        forms=any(is_form(name) for step in loop.steps for name in (step.effect, *step.aliases)),
    )  # fmt: skip
    own = loop.base.model.slices(loop.base.observations.context)
    start = np.concatenate([theta[own[name]] for name in plain.model.names])
    fit = fit_model(plain.model, plain.observations.take(rest), start=start, noise=loop.base.noise)
    rejected: set[str] = set()
    last = ""
    steps: tuple[Step, ...] = ()
    for _ in range(3 * rules.most_effects):
        if len(fit.model.names) >= len(plain.model.names) + rules.most_effects:
            break
        scores = search(fit, effects, rng, rules, rejected, families).scores
        if best := choose(scores, rules, fit.model.names):
            taken = decided(fit, scores, best, options, last)
            if isinstance(taken, Refused):
                rejected.add(taken.name)
                continue
        else:
            smooth = curve_of(fit, scores, options, last) if rules.curves else None
            if smooth is None:
                return fit
            taken = smooth
        step, last = _step(fit, taken, scores, effects, rules), taken.score.name
        fit, steps = exchanged(taken.fit, steps, options.extended)
        steps = (*steps, step)
    return fit


def _step(
    before: Fit,
    taken: Decided,
    scores: tuple[Score, ...],
    effects: Mapping[str, Effect],
    rules: LoopSettings,
) -> Step:
    """What was taken, with its rivals."""
    found = taken.score
    rivals = aliases(before, effects, found, scores, rules) if not taken.curve else ()
    return Step(found.name, found.p, 0, found.evidence, (), rivals or taken.rivals)


def _terms(fit: Fit) -> int:
    """Of its model, without those that set a wrong record aside."""
    return len(fit.model.names) - len(record_names(fit))


def _joined(parts: list[Held], folds: tuple[Fold, ...]) -> Held:
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))
