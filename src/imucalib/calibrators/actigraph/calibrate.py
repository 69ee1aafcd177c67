"""`imucal actigraph`: a worn sensor, calibrated by gravity over days (paper 002, and beyond it)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.actigraph.errors import error_summary
from imucalib.calibrators.actigraph.observations import observations_of, quantisation
from imucalib.calibrators.actigraph.of_a_kind import OfAKind, fit_of_a_kind
from imucalib.calibrators.actigraph.request import HELD, ActigraphRequest
from imucalib.calibrators.actigraph.weak import NINE, base_fit, is_weak
from imucalib.calibrators.rivals import with_rivals
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import named
from imucalib.errors import NotConverged, UsageError
from imucalib.loop.candidates import Searched, searched
from imucalib.loop.found import FitLoop
from imucalib.loop.held_out import Held, fitted, held_out
from imucalib.loop.posterior.recording import Closed, close_recording, followed
from imucalib.rests.runs import PostureRuns, Scan

#: Posture runs a parameter below which what is left over is no noise to search in.
_SEARCHED = 2


@dataclass(frozen=True)
class ActigraphResult:
    """What the reports of `actigraph` show.

    base, final : the nine parameters, and with what the loop added
    base_held, final_held : predictions of each run by fits, and by searches, without its block of
        time
    light : runs that count less, because nothing else is like them
    of_a_kind : what a fleet said, or None where none was asked
    """

    runs: PostureRuns
    loop: FitLoop | None
    base: Fit
    final: Fit
    base_held: Held
    final_held: Held
    error: ErrorSummary
    light: int
    of_a_kind: OfAKind | None = None

    @property
    def added(self) -> bool:
        """Whether the final model has more than the base model."""
        return len(self.final.theta) > len(self.base.theta)

    @property
    def beside_fleet(self) -> bool:
        """Whether the calibration stands on what a fleet said."""
        return self.of_a_kind is not None and self.of_a_kind.taken

    @property
    def weak(self) -> bool:
        """Whether the postures leave some of the nine parameters open."""
        return is_weak(self.base)

    @property
    def few(self) -> bool:
        """Whether the runs are too few to search in."""
        return _few(self.base)

    @property
    def fitted(self) -> Held:
        return fitted(self.final)


def calibrate(runs: PostureRuns, scanned: Scan, request: ActigraphRequest) -> ActigraphResult:
    """Fit, search for what is missing, and measure the error on time that was not fitted.

    Where the postures leave parameters open, these stay near their nominal values (see
    `weak`) and nothing is searched for; nor is it in fewer than two runs a parameter. Raises
    NotConverged.
    """
    data = observations_of(runs, scanned, request.gravity, request.blocks)
    model = base_model(request, data)
    base, light = base_fit(model, data, runs)
    said = None
    if request.kind is not None:
        said, base, fewer = fit_of_a_kind(request.kind, base, runs)
        light = fewer if said.taken else light
    if not base.converged:
        raise NotConverged("the fit did not settle", where=scanned.path)
    if not request.loop or _few(base) or is_weak(base) or (said is not None and said.taken):
        held = held_out(base)
        error = error_summary(base, base, held, held)
        return ActigraphResult(
            runs=runs,
            loop=None,
            base=base,
            final=base,
            base_held=held,
            final_held=held,
            error=error,
            light=light,
            of_a_kind=said,
        )
    return replace(_of_loop(runs, search(base, runs, request), request), of_a_kind=said)


def _few(base: Fit) -> bool:
    return base.observations.n < _SEARCHED * len(base.theta)


def _of_loop(runs: PostureRuns, closed: Closed, request: ActigraphRequest) -> ActigraphResult:
    """What the loop found, with the doubt between models in its intervals, and the course of its
    bias where that is proved: parts of a recording follow what moves with time themselves."""
    loop = closed.loop
    final = with_rivals(loop.final, loop.weighed, request.gravity)
    course = followed(final, closed.course) if _bends(request) else None
    if course is not None and loop.wander is not None:
        loop = replace(loop, wander=replace(loop.wander, followed=True))
    loop = replace(loop, final=course or final)
    return ActigraphResult(
        runs=runs,
        loop=loop,
        base=loop.base,
        final=loop.final,
        base_held=closed.before,
        final_held=closed.after,
        error=error_summary(loop.base, loop.final, closed.before, closed.after),
        light=closed.course.light,
    )


def _bends(request: ActigraphRequest) -> bool:
    """Whether the course of a bias may be followed."""
    return request.curves and "curve" not in request.without and request.every is None


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


def search(base: Fit, runs: PostureRuns, request: ActigraphRequest) -> Closed:
    """The closed loop over the catalogue and its scans, under a noise that wanders."""
    known = quantisation(runs) ** 2 + runs.window_noise**2 / runs.windows
    return close_recording(base, wanted(request), known, curves=request.curves)


def wanted(request: ActigraphRequest) -> Searched:
    """Sensor effects and scans: a fixture is nothing that a wrist has. Of free functions, which the
    posterior has by itself, only that of the posture is a scan."""
    found = searched(
        request.only, request.without, request.extra_effects, lambda e: e.stage == "sensor"
    )
    kept = (f for f in found.families if f.name not in HELD)
    return replace(found, families=tuple(kept))


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
