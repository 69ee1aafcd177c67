"""`imucal actigraph`: a worn sensor, calibrated by gravity over days (paper 002, and beyond it)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.actigraph.errors import error_summary
from imucalib.calibrators.actigraph.observations import observations_of, weighted
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.weak import NINE, base_fit, is_weak
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import named
from imucalib.errors import NotConverged, UsageError
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.loop.asked import Searched, searched
from imucalib.loop.closed_loop import close_loop
from imucalib.loop.cross_fit import by_folds, cross_fitted, judged
from imucalib.loop.design import folds_of
from imucalib.loop.found import FitLoop
from imucalib.loop.held_out import Held, fitted, theta_without
from imucalib.rests.runs import PostureRuns, Scan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class ActigraphResult:
    """What the reports of `actigraph` show.

    base, final : the nine parameters, and with what the loop added
    base_held, final_held : predictions of each run by fits without its block of time; where the
        search found something, by searches and fits without a quarter of the blocks
    light : runs that count less, because nothing else is like them
    declined : why the loop's model was not taken, or empty
    widened : factor by which unexplained structure has widened all standard deviations
    """

    runs: PostureRuns
    loop: FitLoop | None
    base: Fit
    final: Fit
    base_held: Held
    final_held: Held
    error: ErrorSummary
    light: int
    declined: str = ""
    widened: float = 1.0

    @property
    def added(self) -> bool:
        """Whether the final model has more than the base model."""
        return len(self.final.theta) > len(self.base.theta)

    @property
    def weak(self) -> bool:
        """Whether the postures leave some of the nine parameters open."""
        return is_weak(self.base)

    @property
    def fitted(self) -> Held:
        return fitted(self.final)


def calibrate(
    runs: PostureRuns, scanned: Scan, request: ActigraphRequest, rng: np.random.Generator
) -> ActigraphResult:
    """Fit, search for what is missing, and measure the error on time that was not fitted.

    Where the postures leave parameters open, these stay near their nominal values (see
    `weak`) and nothing is searched for. Raises NotConverged.
    """
    data = observations_of(runs, scanned, request.gravity, request.blocks)
    model = base_model(request, data)
    base, light = base_fit(model, data, runs)
    if not base.converged:
        raise NotConverged("the fit did not settle", where=scanned.path)
    loop, declined = None, ""
    if request.loop and not is_weak(base):
        loop, light = found_twice(base, light, runs, request, rng)
    folds = folds_of(data)
    base_held = final_held = by_folds(base, folds)
    if loop and loop.steps:
        names, tried = ", ".join(s.effect for s in loop.steps), wanted(request)
        held = cross_fitted(loop, folds, tried.effects, rng, request.rules, tried.families)
        loop = judged(loop, held, "mean")
        base_held, final_held = held.before, held.after if loop.steps else held.before
        if not loop.steps:
            declined = f"{names} not taken: the held-out error is larger with it than without"
    final = loop.as_recorded if loop and loop.steps else base
    error = error_summary(base, final, base_held, final_held)
    widened = 1.0
    if loop and loop.unexplained:
        widened = between_blocks(final)
        final = replace(final, covariance=widened**2 * final.covariance)
    return ActigraphResult(
        runs, loop, base, final, base_held, final_held, error, light, declined, widened
    )


def between_blocks(fit: Fit) -> float:
    """How much more the parameters move from block to block of time than noise explains, as a
    factor on their standard deviations, at least 1 (the delete-one-block jackknife)."""
    group = fit.observations.group
    keys = np.unique(group)
    without = np.array([theta_without(fit, np.flatnonzero(group == key)) for key in keys])
    away = without - without.mean(axis=0)
    scale = (len(keys) - 1) / len(keys)
    # Nine directions that the noise makes equally long, so that no unit and no size dominates.
    spread = scale * np.einsum("gi,ij,gj->", away, np.linalg.pinv(fit.covariance), away)
    return float(np.sqrt(max(1.0, spread / fit.theta.size)))


def base_model(request: ActigraphRequest, data: Observations) -> Model:
    """The nine parameters and what the user declares beside them."""
    declared = tuple(
        request.extra_effects[n] if n in request.extra_effects else named(n)
        for n in request.declare
    )
    for effect in declared:
        if reason := effect.missing(data.context):
            raise UsageError(f"--declare {effect.name}: {reason}", remedy=effect.identify)
    return Model((*(named(n) for n in NINE), *declared))


def found_twice(
    base: Fit, light: int, runs: PostureRuns, request: ActigraphRequest, rng: np.random.Generator
) -> tuple[FitLoop, int]:
    """The search, once more with new weights where the first found something: what was missing
    made runs look strange and the scatter large, which hides smaller effects."""
    loop = search(base, request, rng)
    if not loop.steps:
        return loop, light
    data, now = weighted(loop.as_recorded, runs)
    again = fit_model(base.model, data, start=base.theta)
    return search(again, request, rng), now


def search(base: Fit, request: ActigraphRequest, rng: np.random.Generator) -> FitLoop:
    """The closed loop over the catalogue and its scans."""
    tried = wanted(request)
    return close_loop(
        base.model, base.observations, tried.effects, rng, request.rules, base.theta, tried.families
    )


def wanted(request: ActigraphRequest) -> Searched:
    """Sensor effects and scans: a fixture is nothing that a wrist has."""
    return searched(
        request.only, request.without, request.extra_effects, lambda e: e.stage == "sensor"
    )


def unseen(runs: PostureRuns) -> tuple[str, ...]:
    """Ends of the axes that gravity never came near (0.3 g), in words."""
    g = np.median(np.linalg.norm(runs.mean, axis=1))
    ends = []
    for axis, name in enumerate("xyz"):
        reading = runs.mean[:, axis] / g
        for sign, word in ((1.0, "up"), (-1.0, "down")):
            if (sign * reading).max() < 0.3:
                ends.append(f"{name} {word}")
    return tuple(ends) or ("directions between those that were recorded",)
