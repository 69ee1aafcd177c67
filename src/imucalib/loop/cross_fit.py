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
from imucalib.loop.found import FitLoop, LoopSettings
from imucalib.loop.held_out import Held, errors, theta_without
from imucalib.loop.records import extended, record_names, reduced, set_aside
from imucalib.loop.search import choose, curve_of, effect_named, objection, refined, search

Array = NDArray[np.float64]
Index = NDArray[np.intp]

_FOLDS, _QUARTERS = 10, 4  # folds of single positions, and of long recordings
_FEW = 16


def cross_fitted(
    loop: FitLoop,
    effects: Mapping[str, Effect],
    rng: np.random.Generator,
    settings: LoopSettings,
    families: tuple[Family, ...] = (),
) -> tuple[Held, Held]:
    """Held-out predictions of the base model and of the searched one, every group once.

    Groups are dealt to the folds by chance: dealt in turn, a fold would take whole rings of a
    bench that repeats itself.
    """
    data = loop.plain.observations
    groups, group = np.unique(data.group, return_inverse=True)
    folds = min(groups.size, _FOLDS)
    if groups.size <= _FEW < data.n // 10:
        # Blocks of time in quarters: where a step falls into a block, half a day is too coarse.
        first = np.searchsorted(group, np.arange(groups.size))
        size = np.bincount(group)
        group = 4 * group + 4 * (np.arange(data.n) - first[group]) // size[group]
        groups, folds = np.unique(group), _QUARTERS
    keys = rng.permutation(np.arange(groups.size) % folds)[np.unique(group, return_inverse=True)[1]]
    rules = replace(settings, bar=loop.bar)
    wrong = tuple(r.row for r in loop.records)
    parts: list[tuple[Index, Held, Held]] = []
    for fold in range(folds):
        rows = np.flatnonzero(keys == fold)
        if not rows.size:
            continue
        held = data.take(rows)
        rest = np.setdiff1d(np.arange(data.n), rows)
        chosen = _searched(loop, rest, wrong, effects, rng, rules, families)
        before = errors(loop.plain, theta_without(loop.plain, rows), held)
        parts.append((rows, before, errors(chosen, chosen.theta, held)))
    order = np.argsort(np.concatenate([rows for rows, _, _ in parts]))
    return _joined([a for _, a, _ in parts], order), _joined([b for _, _, b in parts], order)


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


def _joined(parts: list[Held], order: Index) -> Held:
    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))
