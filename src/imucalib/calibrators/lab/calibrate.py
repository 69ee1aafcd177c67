"""`imucal lab`: a tool's accelerometer on a bench with known tool-face and inclination.

Also its other references: directions known without dials, and the same sensor at rest in unknown
attitudes, by the size of gravity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from imucalib.arrays import Index
from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.lab.attitude import AttitudeErrors, attitude_errors
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.errors import LeftOut, Split, error_summary, held_out_splits
from imucalib.calibrators.lab.sessions.between import session_folds
from imucalib.calibrators.population import Population, of_a_kind
from imucalib.calibrators.rivals import with_rivals
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.core.sphere import KnownDirection
from imucalib.effects import catalogue, named
from imucalib.errors import NotConverged, Undetermined, UsageError
from imucalib.estimators.corrected import OBJECTIVES, fit_corrected
from imucalib.estimators.in_a_population import p_value_in_kind
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.noise_mixture import with_noise_integrated
from imucalib.estimators.starting_point import full_matrix_start, linear_map
from imucalib.loop.candidates import searched
from imucalib.loop.found import FitLoop, Rival
from imucalib.loop.held_out import Held, by_folds, fitted, folds_of
from imucalib.loop.posterior.closed import close_loop
from imucalib.loop.posterior.slips import Written

Objective = Literal["settings", "vector", "angles", "paper"]

MODELS: dict[str, tuple[str, ...]] = {
    "linear12": ("mounting", "bias", "scale", "non_orthogonality"),
    "geometric9": ("bias", "scale", "non_orthogonality"),
}


@dataclass(frozen=True)
class LabSettings:
    """What the user chose.

    model : "linear12" (paper 004, model 3) or "geometric9" (model 4)
    objective : "settings" (errors in variables, the default), "vector" (angles taken as exact),
        "angles" (the paper's suggestion for steep inclinations), "paper" (its objective 5)
    declare : effects of the base model beyond `model`; only, without : restrict the search
    train : rows (0-based) to choose and fit on; the rest is the test set
    sigma : declared noise of a reading, m/s², or None to take it from the data
    partial : whether positions may leave something open, which other data close
    population : what a fleet says of the device: its effects are in the base model, and there is no
        search beside a prior
    """

    model: str = "linear12"
    objective: Objective = "settings"
    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    loop: bool = True
    train: Index | None = None
    sigma: float | None = None
    curves: bool = True
    extra_effects: Mapping[str, Effect] = field(default_factory=dict)
    conventions: Conventions = field(default_factory=Conventions)
    population: Population | None = None
    partial: bool = False


@dataclass(frozen=True)
class LabResult:
    """Everything that the reports of `lab` show.

    observations : all rows; used : the rows that were fitted
    splits : leave-one-out, the folds of the design, and the test set of `train`, where they exist
    angles : the final fit's errors in degrees and mg on the fitted rows (KnownVector only)
    strange : of a prior, the chance that a device of the kind is as far from it; else NaN
    """

    observations: Observations
    used: Index
    loop: FitLoop | None
    base: Fit
    final: Fit
    error: ErrorSummary
    splits: tuple[Split, ...]
    angles: AttitudeErrors | None
    settings: LabSettings
    strange: float = float("nan")

    @property
    def rivals(self) -> tuple[Rival, ...]:
        """The models that would do, with their weights."""
        return self.loop.weighed if self.loop else ()


def calibrate(
    observations: Observations,
    settings: LabSettings,
    *,
    written: Written | None = None,
    faulty: bool = False,
) -> LabResult:
    """Fit, search for what is missing, and measure the errors on data that was not fitted.

    written : the sheet as its rows say it, where slips of hand can be read in it
    faulty : slips of hand are known to inflate the noise, until anything looks undetermined

    Raises Undetermined when the positions cannot carry the model, with what is open and what to
    add, and UsageError for unknown models or effects.
    """
    model = base_model(settings, observations)
    used = np.arange(observations.n) if settings.train is None else settings.train
    data = observations.take(used)
    loop, base, final, left = _solved(model, data, settings, _used(written, used))
    # A wrong record inflates the noise until everything looks open: judge without it. Beside a
    # fleet nothing is: what it leaves wide has that sd.
    clean = loop.base if loop else base
    closed = settings.population is not None or faulty or settings.objective in OBJECTIVES
    closed |= settings.partial
    if clean.null_directions and not closed:
        raise undetermined(clean)
    if not final.converged:
        slips = "; ".join(slip.sentence for slip in loop.slips) if loop else ""
        remedy = slips or "check the table; try --no-loop"
        raise NotConverged("the fit did not settle", remedy=remedy)
    searched = base is not final
    final = with_noise_integrated(final)
    base = with_noise_integrated(base) if searched else final
    if loop is not None:
        final = with_rivals(final, loop.weighed, gravity_of(data))
    splits = held_out_splits(base, final, observations, used, settings.objective, left)
    known = isinstance(data.reference, KnownVector)
    angles = attitude_errors(fitted(final), settings.conventions) if known else None
    error = error_summary(base, final, data, splits, settings.sigma)
    return LabResult(
        observations=observations,
        used=used,
        loop=loop,
        base=base,
        final=final,
        error=error,
        splits=splits,
        angles=angles,
        settings=settings,
        strange=float("nan") if settings.population is None else p_value_in_kind(final),
    )


def _solved(
    model: Model, data: Observations, settings: LabSettings, written: Written | None
) -> tuple[FitLoop | None, Fit, Fit, LeftOut]:
    """The search if there is one, base and final model with every record taken as it stands, and
    what is held out."""
    wanted = searched(settings.only, settings.without, settings.extra_effects)
    if settings.population is not None:
        final = of_a_kind(settings.population, model, data)
        return None, final, final, _left_out(final)
    demand_enough(model, data)
    start = full_matrix_start(model, data)
    if settings.objective in OBJECTIVES:
        final = fit_corrected(model, data, settings.objective, start)
        return None, final, final, LeftOut()
    if not settings.loop:
        final = fit_model(model, data, start=start)
        return None, final, final, _left_out(final)
    curves = settings.curves
    closed = close_loop(model, data, wanted, start, written, curves=curves)
    loop = closed.loop
    if closed.left is None:
        return loop, loop.plain, loop.as_recorded, _left_out(loop.plain)
    across = closed.by(session_folds(loop.plain))
    by_session = (across.before, across.after) if across else None
    folds = (closed.left.before, closed.left.after)
    if loop.records or loop.slips:  # the calibration takes them as they stand
        folds = (_by_design(loop.plain), _by_design(loop.as_recorded))
    return loop, loop.plain, loop.as_recorded, LeftOut(folds, by_session)


def _by_design(fit: Fit) -> Held:
    return by_folds(fit, folds_of(fit.observations))


def _used(written: Written | None, rows: Index) -> Written | None:
    """The rows of a sheet that are fitted."""
    return written and replace(written, sheet=written.sheet.take(rows))


def _left_out(fit: Fit) -> LeftOut:
    """Of a model that nothing was chosen for."""
    apart = session_folds(fit)
    across = (by_folds(fit, apart),) * 2 if apart else None
    return LeftOut((_by_design(fit),) * 2, across)


def base_model(settings: LabSettings, observations: Observations) -> Model:
    """The model before the search; by the norm alone a mounting cannot be seen, so it goes."""
    if settings.model not in MODELS:
        raise UsageError(f"unknown model '{settings.model}'", remedy=f"use: {', '.join(MODELS)}")
    names = MODELS[settings.model]
    if not observations.reference.directed:
        names = tuple(name for name in names if name != "mounting")
    extra = {**catalogue(), **settings.extra_effects}
    declared = tuple(extra[n] if n in extra else named(n) for n in settings.declare)
    for effect in declared:
        if reason := effect.missing(observations.context):
            raise UsageError(f"--declare {effect.name}: {reason}", remedy=effect.identify)
    kind = settings.population
    shared = () if kind is None else kind.driven(observations.context)
    every = {e.name: e for e in (*(named(name) for name in names), *declared, *shared)}
    return Model(tuple(every.values()))


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


def undetermined(fit: Fit) -> Undetermined:
    """The refusal, with every open combination in words."""
    return Undetermined(
        "these positions leave open: " + "; ".join(fit.null_directions),
        remedy="add positions off the common cone or meridian, with z of both signs; "
        "`imucal design TABLE` says which one or two help most",
    )


def gravity_of(data: Observations) -> float:
    reference = data.reference
    assert isinstance(reference, KnownVector | KnownDirection | KnownNorm)
    return reference.gravity
