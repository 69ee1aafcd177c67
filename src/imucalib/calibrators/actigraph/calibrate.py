"""`imucal actigraph`: a worn sensor, calibrated by gravity over days (paper 002, and beyond it)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.calibration.outcome import ErrorSummary
from imucalib.calibrators.actigraph.errors import error_summary
from imucalib.calibrators.actigraph.observations import observations_of, quantisation
from imucalib.calibrators.actigraph.of_a_kind import OfAKind, fit_of_a_kind
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.weak import NINE, base_fit, is_weak
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects import families, named
from imucalib.effects.curve import of_temperature
from imucalib.errors import NotConverged, UsageError
from imucalib.loop.asked import Searched, searched
from imucalib.loop.found import FitLoop
from imucalib.loop.held_out import Held, fitted, held_out
from imucalib.loop.wander.engine import Asked, Closed, close
from imucalib.rests.runs import PostureRuns, Scan
from imucalib.units import MG

#: Posture runs a parameter below which what is left over is no noise to search in.
_SEARCHED = 2
#: Free functions of the response that are tried on what is left where a search may not take them.
_PROBED = ("converter", "posture")


@dataclass(frozen=True)
class ActigraphResult:
    """What the reports of `actigraph` show.

    base, final : the nine parameters, and with what the loop added
    base_held, final_held : predictions of each run by fits, and by searches, without its block of
        time
    light : runs that count less, because nothing else is like them
    declined : why the loop's model was not taken, or empty
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
    declined: str = ""
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


def calibrate(
    runs: PostureRuns, scanned: Scan, request: ActigraphRequest, rng: np.random.Generator
) -> ActigraphResult:
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
    return replace(_of_loop(runs, search(base, runs, request, rng)), of_a_kind=said)


def _few(base: Fit) -> bool:
    return base.observations.n < _SEARCHED * len(base.theta)


def _of_loop(runs: PostureRuns, closed: Closed) -> ActigraphResult:
    """A correction is applied where it gains on time that took no part in its choice."""
    loop, declined = closed.loop, ""
    base, final = loop.base, loop.final
    base_held, final_held = closed.base_held, closed.final_held
    if loop.steps and loop.difference is not None and loop.difference.gain <= 0.0:
        names = ", ".join(s.effect for s in loop.steps)
        declined = f"{names} not taken: the held-out error is larger with it than without"
        final, final_held = base, base_held
    error = error_summary(base, final, base_held, final_held)
    return ActigraphResult(
        runs=runs,
        loop=loop,
        base=base,
        final=final,
        base_held=base_held,
        final_held=final_held,
        error=error,
        light=closed.light,
        declined=declined,
    )


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


def search(
    base: Fit, runs: PostureRuns, request: ActigraphRequest, rng: np.random.Generator
) -> Closed:
    """The closed loop over the catalogue and its scans, under a noise that wanders."""
    tried = wanted(request)
    known = (quantisation(runs) ** 2 + runs.window_noise**2 / runs.windows) / MG**2
    asked = {family.name for family in tried.families}
    probes = tuple(families()[n] for n in _PROBED if n not in asked)
    # Parts follow what moves with time, and tell whether it does: no curve may do so before. What
    # swings within a part no part follows.
    bends = request.rules.curves and "curve" in asked
    rules = replace(request.rules, curves=bends, quicker=request.every)
    return close(base, Asked(tried.effects, tried.families, known, rules, probes), rng)


def wanted(request: ActigraphRequest) -> Searched:
    """Sensor effects, scans, and a curve of the temperature: a fixture is nothing that a wrist
    has."""
    found = searched(
        request.only, request.without, request.extra_effects, lambda e: e.stage == "sensor"
    )
    curve = (replace(f, values=of_temperature) if f.name == "curve" else f for f in found.families)
    return replace(found, families=tuple(curve))


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
