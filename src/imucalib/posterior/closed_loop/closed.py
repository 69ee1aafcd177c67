"""The closed loop: fit, ask the posterior what is missing, add it, prove it on rows left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects.record_error import record_of
from imucalib.errors import NotConverged, Undetermined
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.posterior.candidates import SearchedEffects
from imucalib.posterior.closed_loop.folds import LeftOut, leave_folds_out
from imucalib.posterior.closed_loop.found import CheckedError, FitLoop, Step
from imucalib.posterior.closed_loop.words import (
    SelectedModel,
    measure_shown,
    rivals_of,
    scores_of,
    select_model,
)
from imucalib.posterior.held_out import (
    Difference,
    Fold,
    add_density,
    difference,
    folds_of,
    parts_of,
)
from imucalib.posterior.record_errors import accuse, drop_effects, record_names
from imucalib.posterior.search.explored import SearchedPosterior, SearchStart
from imucalib.posterior.search.noise import NoiseHypothesis, between_temperatures, make_bias_walk
from imucalib.posterior.search.problem import Problem
from imucalib.posterior.search.solution import Solved, change, fit_of, noises_of, solve
from imucalib.posterior.slips.trials import Written, repair_sheet
from imucalib.units import MG


@dataclass(frozen=True)
class ClosedLoop:
    """A finished loop, what it explored, and its predictions of what was left out, where anything
    was corrected."""

    loop: FitLoop
    found: SearchedPosterior
    left: LeftOut | None

    def by(self, folds: tuple[Fold, ...]) -> LeftOut | None:
        """The same by other folds; None where there are none, or the rest of one is too little."""
        if not folds:
            return None
        try:
            return leave_folds_out(self.found.problem, self.found.posterior, folds)
        except Undetermined:
            return None


def close_loop(
    model: Model,
    observations: Observations,
    wanted: SearchedEffects,
    start: Array | None = None,
    written: Written | None = None,
    *,
    curves: bool = True,
) -> ClosedLoop:
    """Fit the base model, search for what it lacks, and judge it on rows left out.

    start : θ of the base model to start from; written : the sheet, where slips can be read in it
    curves : whether structure without a name is corrected
    A correction that rows left out refuse is not made. `base` and `final` are those of the table
    with its slips mended and what a wrong record is off by free, `plain` and `as_recorded` take
    every record as it stands.
    """
    plain = fit_model(model, observations, start=start)
    begun = SearchStart.of(plain, wanted)
    uneven = begun.axis_noise()
    if np.any(uneven != 1.0):
        observations = replace(observations, sigma=observations.sigma * uneven)
        plain = fit_model(model, observations, start=plain.theta)
        begun = SearchStart.of(plain, wanted)
    found = repair_sheet(begun.explore(), wanted, written)
    said = select_model(found.problem, found.posterior)
    data, base = _add_walk(found.base.observations, said), found.base
    if data is not base.observations:
        base = fit_model(base.model, data, start=base.theta)
    loop, left = accept_or_reject(
        start_loop(base, plain, wanted, said),
        said,
        lambda one: fit_of(found.problem, one, data),
        lambda final, left: _gain(base, left),
        curves=curves,
    )
    loop = replace(
        loop,
        records=accuse(loop.final, found.aside),
        slips=found.slips,
        weighed=rivals_of(found.problem, found.posterior),
    )
    return ClosedLoop(
        replace(loop, as_recorded=_as_recorded(loop, slips=bool(found.slips))), found, left
    )


def _add_walk(data: Observations, said: SelectedModel[Problem]) -> Observations:
    """The observations, with the bias that walks as a noise of theirs where it more likely does
    than not beside what is told: readings that share an error are worth fewer."""
    grams = said.posterior.grams
    weight = noises_of(said.problem, grams, said.hypothesis.picks)
    walks = dict[float, float]()
    for point, share in zip(grams.points, weight, strict=True):
        if isinstance(point, NoiseHypothesis) and point.walk is not None:
            walks[point.walk[1]] = walks.get(point.walk[1], 0.0) + float(share)
    if sum(walks.values()) <= 0.5:
        return data
    walk = make_bias_walk(data, max(walks, key=lambda memory: walks[memory]))
    return replace(data, shared=(*data.shared, walk))


def _gain(base: Fit, left: LeftOut) -> Difference:
    """What the rows gain but for records that are set aside. Where a law may be what sessions
    differ by, the density of a row says nothing of it: the others of its session know its bias."""
    data, folds = base.observations, folds_of(base.observations)
    aside = [record_of(name) for name in record_names(base)]
    good = ~np.isin(data.context.covariates.get("record", np.arange(data.n)), aside)
    sizes = left.before.size[good], left.after.size[good]
    gain = difference(*sizes, parts_of(folds)[good], len(folds), "rms")
    return gain if between_temperatures(data) else add_density(gain, left.nats)


def _as_recorded(loop: FitLoop, *, slips: bool) -> Fit:
    """The final model with every record taken as it stands: fitted anew where records are set
    aside, where the base model stands at the angles that were meant, and where slips were mended,
    to the table as it was."""
    final, names = loop.final, record_names(loop.final)
    if not loop.steps and final.observations is loop.plain.observations:
        return loop.plain
    one = drop_effects(final, names) if names or not loop.steps else final
    if not slips:
        return one
    return fit_model(one.model, loop.plain.observations, start=one.theta, shrink=one.shrink)


def start_loop(
    base: Fit, plain: Fit, wanted: SearchedEffects, said: SelectedModel[Problem]
) -> FitLoop:
    """The loop before anything is corrected."""
    context = plain.observations.context
    reasons = {name: effect.missing(context) for name, effect in wanted.effects.items()}
    scores = scores_of(said.problem, said.posterior, measure_shown(said.problem, said.posterior))
    return FitLoop(
        base=base,
        final=base,
        plain=plain,
        as_recorded=plain,
        scores=scores,
        first_scores=scores,
        missing={name: reason for name, reason in reasons.items() if reason},
        complete=said.complete,
    )


def accept_or_reject(
    loop: FitLoop,
    said: SelectedModel[Problem],
    fitted: Callable[[Solved], Fit],
    gain_of: Callable[[Fit, LeftOut], Difference],
    *,
    curves: bool,
) -> tuple[FitLoop, LeftOut | None]:
    """The loop with what is told in the model, and the predictions that prove it: the one veto is
    that of data that took no part.

    fitted : makes the final fit of the linear one; gain_of : what is gained by a final fit on what
    was left out; curves : whether structure without a name is corrected
    """
    problem, posterior = said.problem, said.posterior
    free = any(problem.components[place.component].kind == "free" for place in said.places)
    if not said.places:
        return loop, None
    if free and not curves:
        return _reject(loop, said, "curves are not wanted"), None
    try:
        final = fitted(solve(problem, posterior.grams, said.hypothesis))
        if not final.converged:
            raise NotConverged("no fit settles with it")
        left = leave_folds_out(problem, posterior, folds_of(loop.base.observations))
    except (NotConverged, Undetermined) as reason:  # a response that has no inverse, too few data
        return _reject(loop, said, f"{reason}"), None
    gain = gain_of(final, left)
    if not gain.holds:
        why = f"held-out data refuse it: {gain.before / MG:.3g} -> {gain.after / MG:.3g} mg"
        why += "" if np.isnan(gain.nats) else f", {gain.nats:+.1f} nats in density"
        return _reject(loop, said, why, gain), None
    loop = replace(loop, final=final, steps=_steps(said, left), difference=gain)
    size = change(problem, posterior.grams, said.hypothesis) if loop.suspected else 0.0
    return replace(loop, open_size=size), left


def _steps(said: SelectedModel[Problem], left: LeftOut) -> tuple[Step, ...]:
    """One of each place, and of each time that a cause acts."""
    sizes = left.before.rms() / MG, left.after.rms() / MG
    checks, steps = (CheckedError("held-out error, rms", "mg", *sizes),), list[Step]()
    for place in said.places:
        rivals = [(said.name(c), share) for c, share in place.rivals]
        step = said.step(place, checks, rivals)
        named = said.problem.components[place.component].named
        again = said.member(place.component).effects[1:] if named else ()
        alone = replace(step, aliases=(), in_its_place=())
        steps += [step, *(replace(alone, effect=effect.name) for effect, _, _ in again)]
    return tuple(steps)


def _reject(
    loop: FitLoop, said: SelectedModel[Problem], why: str, gain: Difference | None = None
) -> FitLoop:
    """Nothing is corrected: what is missing stays without a name."""
    unexplained = tuple(said.leave_unexplained(place) for place in said.places)
    names = tuple(one.name for one in unexplained)
    return replace(
        loop,
        difference=gain,
        rejected=tuple((name, why) for name in names),
        refuted=names if gain is not None else (),
        unexplained=unexplained,
        open_size=change(said.problem, said.posterior.grams, said.hypothesis),
    )
