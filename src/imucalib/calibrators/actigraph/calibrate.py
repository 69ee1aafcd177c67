"""`imucal actigraph`: a worn sensor, calibrated by gravity over days (paper 002, and beyond it)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.actigraph.errors import error_summary
from imucalib.calibrators.actigraph.observations import (
    NINE,
    OfAKind,
    average_noise,
    base_fit,
    fit_of_a_kind,
    is_weak,
    observations_of,
)
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.rivals import mix_rivals
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import named
from imucalib.errors import NotConverged
from imucalib.posterior.candidates import effects_to_search
from imucalib.posterior.closed_loop.found import FitLoop
from imucalib.posterior.closed_loop.recording import close_recording, follow_bias
from imucalib.posterior.held_out import Predictions, leave_groups_out, predict_fitted
from imucalib.rests.runs import PostureRuns, Scan

#: Posture runs a parameter below which what is left over is no noise to search in.
_SEARCHED = 2


@dataclass(frozen=True)
class ActigraphResult:
    """What the reports of `actigraph` show.

    base, final : the nine parameters, and with what the loop added
    base_held, final_held : predictions of each run by fits, and by searches, without its block of
        time
    downweighted : runs that count less, because nothing else is like them
    of_a_kind : what a fleet said, or None where there was none
    """

    runs: PostureRuns
    loop: FitLoop | None
    base: Fit
    final: Fit
    base_held: Predictions
    final_held: Predictions
    error: ErrorSummary
    downweighted: int
    of_a_kind: OfAKind | None = None

    @property
    def added(self) -> bool:
        """Whether the final model has more than the base model."""
        return len(self.final.theta) > len(self.base.theta)

    @property
    def with_fleet(self) -> bool:
        """Whether the calibration rests on what a fleet said."""
        return self.of_a_kind is not None and self.of_a_kind.used

    @property
    def weak(self) -> bool:
        """Whether the postures leave some of the nine parameters open."""
        return is_weak(self.base)

    @property
    def few(self) -> bool:
        """Whether the runs are too few to search in."""
        return _few(self.base)

    @property
    def fitted(self) -> Predictions:
        return predict_fitted(self.final)


def calibrate(runs: PostureRuns, scanned: Scan, request: ActigraphRequest) -> ActigraphResult:
    """Fit, search for what is missing, and measure the error on time that was not fitted.

    Where the postures leave parameters open, these stay close to their nominal values (see
    `is_weak`) and nothing is searched for; nor is it in fewer than two runs a parameter. Raises
    NotConverged.
    """
    data = observations_of(runs, scanned, request.gravity, request.blocks)
    base, downweighted = base_fit(base_model(request, data), data, runs)
    said = None
    if request.kind is not None:
        said, beside, fewer = fit_of_a_kind(request.kind, base, runs)
        if said.used:
            base, downweighted = beside, fewer
    if not base.converged:
        raise NotConverged("the fit did not settle", where=scanned.path)
    loop, final, fleet = None, base, said is not None and said.used
    if request.loop and not (_few(base) or is_weak(base) or fleet):
        loop, before, after, downweighted = _search_under_walk(base, runs, request)
        base, final = loop.base, loop.final
    else:
        before = after = leave_groups_out(base)
    return ActigraphResult(
        runs=runs,
        loop=loop,
        base=base,
        final=final,
        base_held=before,
        final_held=after,
        error=error_summary(base, final, before, after),
        downweighted=downweighted,
        of_a_kind=said,
    )


def _few(base: Fit) -> bool:
    return base.observations.n < _SEARCHED * len(base.theta)


def base_model(request: ActigraphRequest, data: Observations) -> Model:
    """The nine parameters and what the user declares beside them."""
    return Model((*map(named, NINE), *request.select_declared(data.context)))


def _search_under_walk(
    base: Fit, runs: PostureRuns, request: ActigraphRequest
) -> tuple[FitLoop, Predictions, Predictions, int]:
    """The closed loop under a noise that drifts, over sensor effects and scans: a fixture is
    nothing that a wrist has, and of free functions, which the posterior has by itself, only that of
    the posture is a scan. The doubt between models is in the intervals, and the course of the bias
    is followed where it is proved: parts of a recording follow what moves with time themselves.

    Returns the loop, the errors held out before and after, and how many runs count less.
    """
    wanted = effects_to_search(
        request.only, request.without, request.extra_effects, lambda e: e.stage == "sensor"
    )
    closed = close_recording(base, wanted, average_noise(runs), curves=request.curves)
    loop = closed.loop
    final = mix_rivals(loop.final, loop.weighed, request.gravity)
    if request.curves and "curve" not in request.without and request.every is None:
        course = follow_bias(final, closed.course)
        if course is not None:
            final = course
            if loop.drift is not None:
                loop = replace(loop, drift=replace(loop.drift, followed=True))
    return replace(loop, final=final), closed.before, closed.after, closed.course.light
