"""The closed loop: fit, ask the posterior what is missing, add it, prove it on rows left out."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects.record_error import record_of
from imucalib.errors import NotConverged
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.candidates import Searched
from imucalib.loop.found import Checked, FitLoop, Step, Unexplained
from imucalib.loop.held_out import Difference, Fold, difference, folds_of, parts_of, with_density
from imucalib.loop.posterior.explored import Explored, Start
from imucalib.loop.posterior.held_out import LeftOut, left_out
from imucalib.loop.posterior.noise import Point, shared_bias
from imucalib.loop.posterior.odds import OPEN
from imucalib.loop.posterior.slips import Mended, Written, mended
from imucalib.loop.posterior.solution import change, fit_of, noises_of, solved
from imucalib.loop.posterior.words import Place, Told, name_of, rivals_of, scores_of, told
from imucalib.loop.record_errors import accused, record_names, reduced
from imucalib.units import MG


@dataclass(frozen=True)
class Closed:
    """A finished loop, what it explored, and its predictions of what was left out, where anything
    was corrected."""

    loop: FitLoop
    found: Explored
    left: LeftOut | None

    def by(self, folds: tuple[Fold, ...]) -> LeftOut | None:
        """The same by other folds; None where there are none."""
        return left_out(self.found.problem, self.found.posterior, folds) if folds else None


def close_loop(
    model: Model,
    observations: Observations,
    asked: Searched,
    start: Array | None = None,
    written: Written | None = None,
    *,
    curves: bool = True,
) -> Closed:
    """Fit the base model, search for what it lacks, and judge it on rows left out.

    start : θ of the base model to start from; written : the sheet, where slips can be read in it
    curves : whether structure without a name is corrected
    A correction that rows left out refuse is not made. `base` and `final` are those of the table
    with its slips mended and what a wrong record is off by free, `plain` and `as_recorded` take
    every record as it stands.
    """
    plain = fit_model(model, observations, start=start)
    begun = Start.of(plain, asked)
    uneven = begun.axis_noise()
    if np.any(uneven != 1.0):
        observations = replace(observations, sigma=observations.sigma * uneven)
        plain = fit_model(model, observations, start=plain.theta)
        begun = Start.of(plain, asked)
    state = mended(begun.explored(), asked, written)
    found = state.found
    said = told(found.problem, found.posterior)
    data = _walking(found, said)
    base = found.base
    if data is not base.observations:
        base = fit_model(base.model, data, start=base.theta)
    loop, left = replace(empty(plain, found, asked, said), base=base, final=base), None
    if not correctable(found, said, curves=curves):
        loop = refused(loop, found, said, None)
    elif said.places:
        loop, left = _corrected(loop, found, said, data)
    loop = replace(
        loop,
        records=accused(loop.final, state.aside),
        slips=state.slips,
        weighed=rivals_of(found.problem, found.posterior),
    )
    return Closed(replace(loop, as_recorded=_as_recorded(loop, state)), found, left)


def correctable(found: Explored, said: Told, *, curves: bool) -> bool:
    """Whether what is told may be corrected: structure without a name only with `curves`."""
    places = (found.problem.components[p.component] for p in said.places)
    return curves or not any(c.kind == "free" for c in places)


def _as_recorded(loop: FitLoop, state: Mended) -> Fit:
    """The final model with every record taken as it stands: fitted anew where records are set
    aside, where the base model stands at the angles that were meant, and where slips were mended,
    to the table as it was."""
    final, names = loop.final, record_names(loop.final)
    if final is loop.plain:
        return final
    one = reduced(final, names) if names or not loop.steps else final
    if not state.slips:
        return one
    return fit_model(one.model, loop.plain.observations, start=one.theta, shrink=one.shrink)


def _walking(found: Explored, said: Told) -> Observations:
    """The observations, with the bias that walks as a noise of theirs where it more likely does
    than not beside what is told: readings that share an error are worth fewer."""
    data, posterior = found.base.observations, found.posterior
    weight = noises_of(found.problem, posterior.grams, said.hypothesis.picks)
    walks = dict[float, float]()
    for point, share in zip(posterior.grams.points, weight, strict=True):
        if isinstance(point, Point) and point.walk is not None:
            walks[point.walk[1]] = walks.get(point.walk[1], 0.0) + float(share)
    if sum(walks.values()) <= 0.5:
        return data
    walk = shared_bias(data, max(walks, key=lambda memory: walks[memory]))
    return replace(data, shared=(*data.shared, walk))


def empty(plain: Fit, found: Explored, asked: Searched, said: Told) -> FitLoop:
    """The loop before anything is corrected."""
    missing = {
        name: reason
        for name, effect in asked.effects.items()
        if (reason := effect.missing(plain.observations.context))
    }
    scores = scores_of(found.problem, found.posterior)
    return FitLoop(
        base=found.base,
        final=found.base,
        plain=plain,
        as_recorded=plain,
        scores=scores,
        first_scores=scores,
        missing=missing,
        complete=said.complete,
    )


def _corrected(
    loop: FitLoop, found: Explored, said: Told, data: Observations
) -> tuple[FitLoop, LeftOut | None]:
    """The loop with what is told in the model, unless data that took no part refuse it."""
    one = solved(found.problem, found.posterior.grams, said.hypothesis)
    final = fit_of(found.problem, one, data)
    if not final.converged:
        return refused(loop, found, said, None), None
    folds = folds_of(data)
    try:
        left = left_out(found.problem, found.posterior, folds)
    except NotConverged:  # a response that has no inverse
        return refused(loop, found, said, None), None
    aside = [record_of(name) for name in record_names(found.base)]
    good = ~np.isin(data.context.covariates.get("record", np.arange(data.n)), aside)
    sizes = left.before.size[good], left.after.size[good]
    gain = difference(*sizes, parts_of(folds)[good], len(folds), "rms")
    loop = judged(loop, found, said, final, left, with_density(gain, left.nats))
    return loop, left if loop.steps else None


def judged(
    loop: FitLoop, found: Explored, said: Told, final: Fit, left: LeftOut, gain: Difference
) -> FitLoop:
    """The one veto: what is told is corrected by `final` unless data that took no part refuse."""
    if not gain.holds:
        return refused(loop, found, said, gain)
    steps = tuple(
        _step(found, said, place, _effect(found, place.component, said), left)
        for place in said.places
    )
    loop = replace(loop, final=final, steps=steps, difference=gain)
    size = change(found.problem, found.posterior.grams, said.hypothesis) if loop.suspected else 0.0
    return replace(loop, open_size=size)


def _effect(found: Explored, component: int, said: Told) -> str:
    return name_of(found.problem, found.posterior, said, component)


def _step(found: Explored, said: Told, place: Place, name: str, left: LeftOut) -> Step:
    rivals = tuple((_effect(found, c, said), share) for c, share in place.rivals)
    component = found.problem.components[place.component]
    return Step(
        effect=name,
        evidence=place.log_odds,
        checked=(Checked("error", "m/s2", left.before.rms(), left.after.rms()),),
        aliases=tuple(dict.fromkeys(n for n, _ in rivals if n != name)),
        curve=component.kind == "free",
        probability=place.probability,
        rivals=rivals,
        certain=place.certain,
    )


def refused(loop: FitLoop, found: Explored, said: Told, gain: Difference | None) -> FitLoop:
    """Nothing is corrected; what is missing beyond doubt stays without a name."""
    why = "it has no inverse, no fit settles with it, or curves are not wanted"
    if gain is not None:
        why = f"on data that took no part the error is {gain.before / MG:.3g} mg without it, "
        why += f"{gain.after / MG:.3g} with it"
    names = tuple(_effect(found, place.component, said) for place in said.places)
    left = tuple(
        Unexplained(
            name=name,
            driver=found.problem.components[place.component].driver,
            kind="probe",
            probability=place.probability,
            evidence=0.0,
            rivals=tuple(_effect(found, c, said) for c, _ in place.rivals),
        )
        for place, name in zip(said.places, names, strict=True)
        if said.complete < np.exp(-OPEN)
    )
    return replace(
        loop,
        difference=gain,
        rejected=tuple((name, why) for name in names),
        refuted=names if gain is not None else (),
        unexplained=left,
        open_size=change(found.problem, found.posterior.grams, said.hypothesis) if left else 0.0,
    )
