"""`imucal lab`: a tool's accelerometer on a bench with known tool-face and inclination.

Also its second reference: the same sensor at rest in unknown attitudes, by the size of gravity.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.attitude import AttitudeErrors, attitude_errors
from imucalib.balance import Noise
from imucalib.closed_loop import Loop, LoopSettings, close_loop
from imucalib.conventions import Conventions
from imucalib.effect import Effect
from imucalib.effects import catalogue, named
from imucalib.errors import NotConverged, Undetermined, UsageError
from imucalib.estimators.corrected import OBJECTIVES, fit_corrected
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.fit import Fit
from imucalib.held_out import Held, errors, fitted, held_out
from imucalib.model import Model
from imucalib.observations import Observations
from imucalib.outcome import ErrorSummary, HeldOutError
from imucalib.references import KnownNorm, KnownVector
from imucalib.starting_point import full_matrix_start
from imucalib.units import MG

Array = NDArray[np.float64]
Index = NDArray[np.intp]
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
    """

    model: str = "linear12"
    objective: Objective = "settings"
    declare: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    without: tuple[str, ...] = ()
    loop: bool = True
    train: Index | None = None
    sigma: float | None = None
    rules: LoopSettings = field(default_factory=LoopSettings)
    extra_effects: Mapping[str, Effect] = field(default_factory=dict)
    conventions: Conventions = field(default_factory=Conventions)


@dataclass(frozen=True)
class Split:
    """A held-out part: its name, its rows of the whole table, and the errors there."""

    name: str
    rows: Index
    base: Held
    final: Held


@dataclass(frozen=True)
class LabResult:
    """Everything that the reports of `lab` show.

    observations : all rows; used : the rows that were fitted
    splits : leave-one-out, and the test set of `train` when there is one
    angles : the final fit's errors in degrees and mg on the fitted rows (KnownVector only)
    """

    observations: Observations
    used: Index
    loop: Loop | None
    base: Fit
    final: Fit
    error: ErrorSummary
    splits: tuple[Split, ...]
    angles: AttitudeErrors | None
    settings: LabSettings


def calibrate(
    observations: Observations, settings: LabSettings, rng: np.random.Generator
) -> LabResult:
    """Fit, search for what is missing, and measure the errors on data that was not fitted.

    Raises Undetermined when the positions cannot carry the model, with what is open and what to
    add, and UsageError for unknown models or effects.
    """
    model = base_model(settings, observations)
    searched = searched_effects(settings)
    used = np.arange(observations.n) if settings.train is None else settings.train
    data = observations.take(used)
    demand_enough(model, data)
    start = full_matrix_start(model, data)
    if settings.objective in OBJECTIVES:
        base = fit_corrected(model, data, settings.objective, start)
        loop, final = None, base
    elif settings.loop:
        loop = close_loop(model, data, searched, rng, settings.rules, start)
        base, final = loop.plain, loop.as_recorded
    else:
        loop, base = None, fit_model(model, data, start=start)
        final = base
    # A wrong record inflates the noise until everything looks open: judge without it.
    judged = loop.base if loop else base
    if judged.null_directions and settings.objective not in OBJECTIVES:
        raise undetermined(judged)
    if not final.converged:
        raise NotConverged("the fit did not settle", remedy="check the table; try --no-loop")
    splits = _splits(base, final, observations, used, settings)
    gravity = gravity_of(data)
    known = isinstance(data.reference, KnownVector)
    angles = attitude_errors(fitted(final), gravity) if known else None
    error = error_summary(base, final, data, splits)
    return LabResult(observations, used, loop, base, final, error, splits, angles, settings)


def base_model(settings: LabSettings, observations: Observations) -> Model:
    """The model before the search; by the norm alone a mounting cannot be seen, so it goes."""
    if settings.model not in MODELS:
        raise UsageError(f"unknown model '{settings.model}'", remedy=f"use: {', '.join(MODELS)}")
    names = MODELS[settings.model]
    if isinstance(observations.reference, KnownNorm):
        names = tuple(name for name in names if name != "mounting")
    extra = {**catalogue(), **settings.extra_effects}
    declared = tuple(extra[n] if n in extra else named(n) for n in settings.declare)
    for effect in declared:
        if reason := effect.missing(observations.context):
            raise UsageError(f"--declare {effect.name}: {reason}", remedy=effect.identify)
    return Model((*(named(name) for name in names), *declared))


def searched_effects(settings: LabSettings) -> dict[str, Effect]:
    """The catalogue as `only` and `without` leave it; UsageError for a name that is not there."""
    every = {**catalogue(), **settings.extra_effects}
    for name in (*settings.only, *settings.without):
        if name not in every:
            named(name)
    chosen = settings.only or tuple(every)
    return {name: every[name] for name in chosen if name not in settings.without}


def demand_enough(model: Model, data: Observations) -> None:
    """Raise Undetermined when there are fewer numbers than parameters."""
    parameters = len(model.parameters(data.context))
    numbers = 3 * data.n if isinstance(data.reference, KnownVector) else data.n
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
    assert isinstance(reference, KnownVector | KnownNorm)
    return reference.gravity


def _splits(
    base: Fit, final: Fit, whole: Observations, used: Index, settings: LabSettings
) -> tuple[Split, ...]:
    found: list[Split] = []
    if settings.objective in OBJECTIVES:
        left = refitted(final, settings.objective)
        found += [Split("leave one out", used, left, left)] if left else []
    else:
        found = [Split("leave one out", used, held_out(base), held_out(final))]
    rest = np.setdiff1d(np.arange(whole.n), used)
    if rest.size:
        test = whole.take(rest)
        tested = [errors(f, f.theta, test) for f in (base, final)]
        found.append(Split("test set", rest, *tested))
    return tuple(found)


def refitted(fit: Fit, objective: str) -> Held | None:
    """Leave one out by complete refits, for objectives that are not a likelihood.

    None when a position is indispensable: without it the objective has no minimum.
    """
    data = fit.observations
    parts = []
    for row in range(data.n):
        rest = data.without(np.array([row]))
        try:
            theta = fit_corrected(fit.model, rest, objective, fit.theta).theta
        except NotConverged:
            return None
        parts.append(errors(fit, theta, data.take(np.array([row]))))
    return Held(
        np.concatenate([part.corrected for part in parts]),
        np.concatenate([part.expected for part in parts]),
        np.concatenate([part.error for part in parts]),
    )


def error_summary(
    base: Fit, final: Fit, data: Observations, splits: tuple[Split, ...]
) -> ErrorSummary:
    """The one metric of the loop: length of the vector error, or error of the norm, rms in mg.

    Held out are the rows of the test set when there is one, else each row in turn; NaN where
    neither exists.
    """
    base_out, final_out = (
        (splits[-1].base.rms() / MG, splits[-1].final.rms() / MG) if splits else (np.nan, np.nan)
    )
    nothing = Model(())
    bare = replace(base, model=nothing, theta=np.zeros(0))
    raw = errors(bare, bare.theta, data).rms() / MG
    known = isinstance(data.reference, KnownVector)
    return ErrorSummary(
        "vector error, rms" if known else "error of |a|, rms",
        "mg",
        raw,
        fitted(base).rms() / MG,
        fitted(final).rms() / MG,
        noise_floor(final) / MG,
        HeldOutError(raw, base_out, final_out),
    )


def noise_floor(fit: Fit) -> float:
    """rms of the metric that noise and setting errors alone would leave, m/s²."""
    at, noise = fit.at, fit.noise
    scale = at.sigma.reshape(-1) if at.keep.shape[2] == at.sigma.shape[1] else at.sigma[:, 0]
    power = (noise.factor * scale) ** 2
    for matrix, sd in zip(at.settings, noise.sd, strict=True):
        power = power + (sd * scale) ** 2 * np.sum(matrix**2, axis=1)
    return float(np.sqrt(power.sum() / fit.observations.n))


def setting_noise(noise: Noise) -> dict[str, float]:
    """Standard deviations (rad) by component name."""
    return dict(zip(noise.component, noise.sd, strict=True))
