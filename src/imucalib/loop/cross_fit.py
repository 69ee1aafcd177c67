"""Before and after on data that took no part in the choice: the search itself is repeated.

An effect that was chosen on all data has seen what a leave-one-out error calls held out. Here each
fold is predicted by a model that was searched for and fitted without it. The evidence that a
candidate must reach is that of the whole search, so no new data need to be simulated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.design import Fold, parts_of
from imucalib.loop.difference import Metric, difference
from imucalib.loop.found import FitLoop, LoopSettings, Unexplained
from imucalib.loop.held_out import Held, errors, theta_without, without_records
from imucalib.loop.records import extended, record_names, reduced, set_aside
from imucalib.loop.search import choose, curve_of, effect_named, objection, refined, search
from imucalib.units import MG

Array = NDArray[np.float64]
Index = NDArray[np.intp]

#: Nats from which on an effect that held-out data refuse is structure without a name, no accident.
_STRONG = 10.0


def cross_fitted(
    loop: FitLoop,
    folds: tuple[Fold, ...],
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings,
    families: tuple[Family, ...] = (),
) -> tuple[Held, Held]:
    """Held-out predictions of the base model and of the searched one, by the same folds."""
    rules = replace(settings, bar=loop.bar)
    wrong = tuple(r.row for r in loop.records)
    data = loop.plain.observations
    after = []
    for fold in folds:
        chosen = _searched(loop, fold.rest, wrong, effects, rng, rules, families)
        after.append(errors(chosen, chosen.theta, data.take(fold.rows)))
    return by_folds(loop.plain, folds), _joined(after, folds)


def by_folds(fit: Fit, folds: tuple[Fold, ...]) -> Held:
    """Held-out predictions of a model that nothing was chosen for."""
    data = fit.observations
    every = np.arange(data.n)
    parts = []
    for fold in folds:
        theta = without_records(fit, theta_without(fit, np.setdiff1d(every, fold.rest)))
        parts.append(errors(fit, theta, data.take(fold.rows)))
    return _joined(parts, folds)


def judged(
    loop: FitLoop, folds: tuple[Fold, ...], before: Held, after: Held, metric: Metric
) -> FitLoop:
    """The loop with the word of data that took no part: the difference, and nothing taken where the
    error there has not fallen. Records that are wrong prove nothing for or against an effect."""
    good = np.setdiff1d(np.arange(loop.plain.observations.n), [r.row for r in loop.records])
    part = parts_of(folds)[good]
    found = difference(before.size[good], after.size[good], part, len(folds), metric)
    if found.gain > 0.0:
        return replace(loop, difference=found)
    why = f"on data that took no part the error is {found.before / MG:.3g} mg without it, "
    why += f"{found.after / MG:.3g} with it"
    strong = tuple(
        Unexplained(f"what looks like {s.effect}", "", "probe", s.p, s.evidence, 0.0)
        for s in loop.named
        if s.evidence > _STRONG
    )
    return replace(
        loop,
        final=loop.base,
        as_recorded=loop.plain,
        steps=(),
        rejected=(*loop.rejected, *((s.effect, why) for s in loop.steps)),
        unexplained=(*loop.unexplained, *strong),
        difference=found,
    )


def _searched(
    loop: FitLoop,
    rest: Index,
    wrong: tuple[int, ...],
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    rules: LoopSettings,
    families: tuple[Family, ...],
) -> Fit:
    """The loop on a part of the data; records count as they stand in what is returned, as in the
    calibration itself. The noise is that of the whole, before and after: a nuisance that costs
    most of the time and tells nothing about the choice."""
    plain, noise = loop.plain, loop.final.noise
    data = plain.observations.take(rest)
    fit = fit_model(plain.model, data, start=plain.theta, noise=loop.base.noise)
    for row in np.flatnonzero(np.isin(rest, wrong)):
        fit = set_aside(fit, int(row))
    rejected: dict[str, str] = {}
    for _ in range(3 * rules.most_effects):
        if len(fit.model.names) >= len(plain.model.names) + rules.most_effects + len(wrong):
            break
        scores = search(fit, effects, rng, rules, rejected, families).scores
        best = choose(scores, rules)
        if best is None:
            smooth = curve_of(fit, scores, rules) if rules.curves else None
            fit = smooth[1] if smooth else fit
            break
        best = refined(fit, best, families, rng, rules)
        trial = extended(fit, effect_named(effects, best.name), noise=noise)
        if reason := objection(fit, trial):
            rejected[best.candidate.family or best.name] = reason
        else:
            fit = trial
    return reduced(fit, record_names(fit)) if wrong else fit


def _joined(parts: list[Held], folds: tuple[Fold, ...]) -> Held:
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))
