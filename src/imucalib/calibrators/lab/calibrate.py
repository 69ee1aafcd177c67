"""`imucal lab`: a tool's accelerometer on a bench with known tool-face and inclination.

Also its other references: directions known without dials, and the same sensor at rest in unknown
attitudes, by the size of gravity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.lab.errors import Split, error_summary, leave_each_out, session_folds
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.population import of_a_kind
from imucalib.calibrators.rivals import mix_rivals
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.core.sphere import KnownDirection
from imucalib.effects import named
from imucalib.errors import NotConverged, Undetermined, UsageError
from imucalib.estimators.corrected import OBJECTIVES, fit_corrected
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.noise_mixture import integrate_noise
from imucalib.estimators.starting_point import full_matrix_start, linear_map
from imucalib.estimators.variance import kind_chance
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.closed import close_loop
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.posterior.held_out import Predictions, by_folds, folds_of
from imucalib.posterior.slips.trials import Written

MODELS: dict[str, tuple[str, ...]] = {
    "linear12": ("mounting", "bias", "scale", "non_orthogonality"),
    "geometric9": ("bias", "scale", "non_orthogonality"),
}


@dataclass(frozen=True)
class LabResult:
    """Everything that the reports of `lab` show.

    observations : all rows; used : the rows that were fitted
    splits : leave-one-out, the folds of the design, and the test set of `train`, where they exist
    kind_chance : of a prior, the chance that a device of the kind is as far from it; else NaN
    """

    observations: Observations
    used: Index
    loop: FitLoop | None
    base: Fit
    final: Fit
    error: ErrorSummary
    splits: tuple[Split, ...]
    request: LabRequest
    kind_chance: float


@dataclass(frozen=True)
class _Solved:
    """The search if there is one, base and final model with every record taken as it is, and the
    errors, before and after, of splits for which everything was chosen anew."""

    loop: FitLoop | None
    base: Fit
    final: Fit
    chosen_anew: dict[str, tuple[Predictions, Predictions]]


def calibrate(
    observations: Observations,
    request: LabRequest,
    *,
    train: Index | None = None,
    written: Written | None = None,
    faulty: bool = False,
) -> LabResult:
    """Fit, search for what is missing, and measure the errors on data that was not fitted.

    train : rows (from 0) to choose and fit on, None for all
    written : the sheet as its rows say it, where slips of hand can be read in it
    faulty : slips of hand are known to inflate the noise, until anything looks undetermined

    Raises Undetermined when the positions cannot carry the model, with what is open and what to
    add, and UsageError for unknown models or effects.
    """
    model = base_model(request, observations)
    used = np.arange(observations.n) if train is None else train
    data = observations.take(used)
    if written is not None:
        written = replace(written, sheet=written.sheet.take(used))
    solved = _solve(model, data, request, written)
    loop, base, final = solved.loop, solved.base, solved.final
    # A wrong record inflates the noise until everything looks open: judge without it. Beside a
    # fleet nothing is: what it leaves wide has that sd.
    clean = loop.base if loop else base
    closed = request.population is not None or faulty or request.objective in OBJECTIVES
    if clean.null_directions and not (closed or request.partial):
        raise Undetermined(
            "these positions leave open: " + "; ".join(clean.null_directions),
            remedy="add positions off the common cone or meridian, with z of both signs; "
            "`imucal design TABLE` says which one or two help most",
        )
    # A gross slip may keep the fit of the sheet as it stands from settling; it is undecided anyway.
    if not (final.converged or (loop and loop.slips)):
        raise NotConverged("the fit did not settle", remedy="check the table; try --no-loop")
    one_fit = base is final
    final = integrate_noise(final)
    base = final if one_fit else integrate_noise(base)
    if loop is not None:
        final = mix_rivals(final, loop.weighed, gravity_of(data))
    splits = leave_each_out(base, final, observations, used, request.objective, solved.chosen_anew)
    return LabResult(
        observations=observations,
        used=used,
        loop=loop,
        base=base,
        final=final,
        error=error_summary(base, final, data, splits, request.sigma),
        splits=splits,
        request=request,
        kind_chance=float("nan") if request.population is None else kind_chance(final),
    )


def _solve(
    model: Model, data: Observations, request: LabRequest, written: Written | None
) -> _Solved:
    wanted = effects_to_search(request.only, request.without, request.extra_effects)
    if request.population is not None:
        return _without_search(of_a_kind(request.population, model, data))
    demand_enough(model, data)
    start = full_matrix_start(model, data)
    if request.objective in OBJECTIVES:
        final = fit_corrected(model, data, request.objective, start)
        return _Solved(None, final, final, {})
    if not request.loop:
        return _without_search(fit_model(model, data, start=start))
    closed = close_loop(model, data, wanted, start, written, curves=request.curves)
    loop = closed.loop
    if closed.left is None:
        return replace(_without_search(loop.plain), loop=loop, final=loop.as_recorded)
    chosen_anew = {}
    if across := closed.by(session_folds(loop.plain)):
        chosen_anew["another session"] = (across.before, across.after)
    chosen_anew["held out"] = (closed.left.before, closed.left.after)
    if loop.records or loop.slips:  # the calibration takes them as they are
        chosen_anew["held out"] = (_by_design(loop.plain), _by_design(loop.as_recorded))
    return _Solved(loop, loop.plain, loop.as_recorded, chosen_anew)


def _without_search(fit: Fit) -> _Solved:
    """A model that nothing was chosen for."""
    chosen_anew = {}
    if apart := session_folds(fit):
        chosen_anew["another session"] = (by_folds(fit, apart),) * 2
    chosen_anew["held out"] = (_by_design(fit),) * 2
    return _Solved(None, fit, fit, chosen_anew)


def _by_design(fit: Fit) -> Predictions:
    return by_folds(fit, folds_of(fit.observations))


def base_model(request: LabRequest, observations: Observations) -> Model:
    """The model before the search; by the norm alone a mounting cannot be seen, so it goes."""
    if request.model not in MODELS:
        raise UsageError(f"unknown model '{request.model}'", remedy=f"use: {', '.join(MODELS)}")
    names = MODELS[request.model]
    if not observations.reference.directed:
        names = tuple(name for name in names if name != "mounting")
    kind, context = request.population, observations.context
    shared = () if kind is None else kind.select_shared(context)
    effects = (*map(named, names), *request.select_declared(context), *shared)
    return Model(tuple({e.name: e for e in effects}.values()))


def demand_enough(model: Model, data: Observations) -> None:
    """Raise Undetermined when there are fewer numbers than parameters, or too few directions."""
    if isinstance(data.reference, KnownDirection) and linear_map(data)[2] < 4:
        raise Undetermined(
            "the directions lie on a plane or a cone: three scales and a bias cannot be told apart",
            remedy="add the faces that are missing: each axis up and down",
        )
    parameters = len(model.parameters(data.context))
    numbers = 3 * data.n if data.reference.directed else data.n
    if numbers <= parameters:
        raise Undetermined(
            f"{data.n} positions give {numbers} numbers for {parameters} parameters",
            remedy="add positions; `imucal design` says which help most",
        )


def gravity_of(data: Observations) -> float:
    """m/s², of the reference."""
    reference = data.reference
    assert isinstance(reference, KnownVector | KnownDirection | KnownNorm)
    return reference.gravity
