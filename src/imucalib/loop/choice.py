"""What a search takes: a name or a curve without one, whichever predicts data that were left out.

Both are judged side by side. A name goes first where it does about as well: a curve holds every
shape of its driver. A curve is taken only where what it gains beyond the name is clear.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.core.balance import Noise, whitener
from imucalib.core.effect import Effect, Family
from imucalib.core.fit import Fit
from imucalib.core.identifiability import null_directions
from imucalib.core.observations import Observations
from imucalib.effects import known
from imucalib.loop.candidates import effect_columns
from imucalib.loop.evidence import Score
from imucalib.loop.found import LoopSettings
from imucalib.loop.held_out import log_predictive, log_predictives
from imucalib.loop.records import extended, reduced
from imucalib.loop.search import (
    choose,
    clear,
    effect_named,
    objection,
    passes,
    refined,
    search,
)
from imucalib.loop.shapes import better_form, form_of
from imucalib.loop.subject import Refused
from imucalib.loop.thresholds import (
    CURVE_LEAD,
    CURVE_NATS,
    CURVE_RMS,
    CURVE_SHARE,
    CURVE_TERMS,
    NUMBERS,
)


@dataclass(frozen=True)
class Decided:
    """What is taken, and the fit with it; curve : whether it has no name; rivals : other forms that
    do about as well; drops : earlier effects whose part it takes over."""

    score: Score
    fit: Fit
    curve: bool
    rivals: tuple[str, ...] = ()
    drops: tuple[str, ...] = ()


@dataclass(frozen=True)
class Options:
    """What a choice may try.

    noise, data : to hold a refit at, where a search of the whole data has estimated them; else they
        are estimated anew
    terms : of the model that the noise is of: with fewer, what is still missing is noise too, and
        the noise is estimated anew
    forms : whether a form may take the place of a name: not in a fold of data in which none comes
        near it, which would cost half a search
    """

    effects: Mapping[str, Effect]
    families: tuple[Family, ...]
    rng: np.random.Generator
    rules: LoopSettings
    noise: Noise | None = None
    data: Observations | None = None
    terms: int = 0
    forms: bool = True

    def extended(self, fit: Fit, effect: Effect) -> Fit:
        """Refit with one more effect."""
        if self.data is not None:
            fit = replace(fit, observations=self.data)
        whole = len(fit.model.names) + 1 >= self.terms
        return extended(fit, effect, noise=self.noise if whole else None)


def decided(
    current: Fit, scores: tuple[Score, ...], chosen: Score, options: Options, last: str = ""
) -> Decided | Refused:
    """The chosen effect or the curve that explains clearly more; or why neither is taken.

    last : the effect that was taken before, if any
    """
    rules = options.rules
    chosen = refined(current, chosen, options.families, options.rng, rules)
    trial = options.extended(current, effect_named(options.effects, chosen.name))
    if why := objection(current, trial):
        return Refused(chosen.candidate.family or chosen.name, why.reason, why.by_data)
    best = next((s for s in scores if passes(s, rules) and s.candidate.curve), None)
    if best is None or best.evidence < chosen.evidence + rules.margin:
        return _named(current, chosen, trial, options)
    smooth = curve_of(current, scores, options, last)
    if smooth is None or not _outdone(smooth, trial, current, options):
        return _named(current, chosen, trial, options)
    if rules.curves:
        return smooth
    stronger = f"a curve without a name explains clearly more: {smooth.score.candidate.driver}"
    return Refused(chosen.candidate.family or chosen.name, stronger)


def _named(current: Fit, chosen: Score, trial: Fit, options: Options) -> Decided:
    """A name, and the form of the same driver that explains as much, if one does: beside it, or in
    its place where it explains clearly more and data that were left out say so too."""
    name = Decided(chosen, trial, curve=False)
    if not options.forms:
        return name
    form = better_form(current, effect_named(options.effects, chosen.name), chosen, options.rng)
    if form is None:
        return name
    if form.score.evidence > chosen.evidence + options.rules.margin:
        other = options.extended(current, form.effect)
        if not objection(current, other) and _leads(other, trial, current):
            return Decided(form.score, other, curve=False, rivals=form.rivals)
    return replace(name, rivals=(form.effect.name,))


def _outdone(smooth: Decided, trial: Fit, current: Fit, options: Options) -> bool:
    """Whether a curve predicts clearly better than a name does, and than that name and the one that
    is then found beside it: two effects at once look like a curve of what both go with."""
    leads = _leads(smooth.fit, trial, current)
    if not leads or not smooth.curve:
        return leads
    rules, effects = options.rules, options.effects
    found = search(trial, effects, options.rng, rules, (), options.families)
    second = choose(found.scores, rules)
    if second is None:
        return True
    both = options.extended(trial, effect_named(effects, second.name))
    return objection(trial, both) is not None or _leads(smooth.fit, both, current)


def _leads(curve: Fit, name: Fit, before: Fit) -> bool:
    """Whether a curve predicts what was left out clearly better than a name does."""
    own = log_predictives(curve)
    lead = own - log_predictives(name)
    total, spread = float(lead.sum()), float(np.std(lead, ddof=1)) * lead.size**0.5
    gained = float(own.sum()) - log_predictive(before)
    return total > CURVE_LEAD * spread and total > CURVE_SHARE * gained


def curve_of(
    current: Fit, scores: tuple[Score, ...], options: Options, last: str = ""
) -> Decided | None:
    """The strongest probe as a correction: by a form with a formula where it has one, else without
    a name, its terms chosen by what holds out.

    It has to gain more than an effect has to: nothing but the data speak for it. A curve beside the
    effect that was taken before may be what is left of one form.
    """
    own = {name.rpartition(":")[0] for name in current.model.names if name.startswith("curve@")}
    found = next(
        (
            s
            for s in scores
            if clear(s, options.rules)
            and s.candidate.curve
            and f"curve@{s.candidate.curve}" not in own
        ),
        None,
    )
    if found is None:
        return None
    smooth = _smoothed(current, found, options)
    formed = _formed(current, found, smooth, options)
    if formed is None and last and smooth:
        one = _formed(reduced(current, (last,)), found, smooth, options)
        formed = one and replace(one, drops=(last,))
    return formed or smooth


def undetermined(fit: Fit, effect: Effect) -> bool:
    """Whether the data clearly cannot determine an effect beside a fit, asked before any refit: too
    few numbers, or directions that would be open at half of the noise too."""
    added = effect.parameters(fit.observations.context)
    if (len(fit.theta) + len(added)) * NUMBERS > fit.at.residual.size:
        return True
    if fit.prior is not None:
        return False
    white = whitener(fit.at.settings, fit.noise.ratio)
    columns = effect_columns(fit, effect) / np.array([p.typical for p in added])
    both = white(np.column_stack([fit.at.jacobian, columns]))
    found = null_directions(both, (*fit.parameters, *added), fit.noise.factor / 2.0)
    return len(found) > len(fit.null_directions)


def _formed(current: Fit, found: Score, smooth: Decided | None, options: Options) -> Decided | None:
    """A form with a formula in place of a curve, where it predicts about as well. Where no curve
    holds out, which spends many terms, a form has to gain what a curve must."""
    form = form_of(current, found, options.rng)
    if form is None or form.effect.missing(current.observations.context):
        return None
    if undetermined(current, form.effect):
        return None
    trial = options.extended(current, form.effect)
    bar = () if smooth else (CURVE_NATS, CURVE_RMS)
    if objection(current, trial, *bar) or (smooth and _leads(smooth.fit, trial, current)):
        return None
    return Decided(form.score, trial, curve=False, rivals=form.rivals)


def _smoothed(current: Fit, found: Score, options: Options) -> Decided | None:
    best, most = None, -np.inf
    for terms in CURVE_TERMS:
        effect = known(f"curve@{found.candidate.curve}:{terms}")
        assert effect is not None, found.candidate.curve
        if effect.missing(current.observations.context) or undetermined(current, effect):
            continue
        trial = options.extended(current, effect)
        if objection(current, trial, CURVE_NATS, CURVE_RMS):
            continue
        if (density := log_predictive(trial)) > most:
            named = replace(found, candidate=replace(found.candidate, name=effect.name))
            best, most = Decided(named, trial, curve=True), density
    return best
