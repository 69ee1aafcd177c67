"""Paper 002's own procedure from a recording to coefficients, with its comparisons.

Calibration points as paper 002 collects them: nine bins, filled while the recording runs.

Each axis has three bins of mean readings, [-1.25, -0.75], [-0.25, 0.25] and [0.75, 1.25] g (eq.
(10)). A point goes into one bin, the first open one that it belongs to; ends of axes come before
their middles, since few postures reach them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.outcome import ErrorSummary, HeldOutError, Limit, Outcome, Run
from imucalib.calibrators.actigraph.observations import NINE
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import calibration_of, provenance
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.data import Data, plain
from imucalib.effects import named
from imucalib.errors import Undetermined
from imucalib.estimators.gradient_descent import METHODS, START, improvement, mean_error
from imucalib.estimators.least_squares import evaluate
from imucalib.readers import blocks
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.runs import Scan, scan
from imucalib.units import MG

#: The paper's rule of stillness: seconds of a segment, and max - min (g) on one axis.
SECONDS, RANGE_G = 5.0, 0.12
_HALF_WIDTH, _EACH = 0.25, 2
#: (axis, centre in g), ends first.
BINS = tuple((axis, c) for c in (-1.0, 1.0, 0.0) for axis in range(3))
ARITHMETIC = {
    "float": "gradient descent",
    "int32": "gradient descent, 32-bit",
    "int16": "gradient descent, 16-bit",
}
_NAMES = ("k_xx", "k_yy", "k_zz", "k_xy", "k_xz", "k_yz", "o_x", "o_y", "o_z")


@dataclass
class PointCollector:
    """Takes points one at a time and keeps those that an open bin needs: two of each, 18 in all."""

    points: list[Array] = field(default_factory=list)
    count: list[int] = field(default_factory=lambda: [0] * len(BINS))

    @property
    def ready(self) -> bool:
        """Whether every bin is full."""
        return min(self.count) == _EACH

    @property
    def missing(self) -> tuple[str, ...]:
        """Bins that are not full, in words."""
        pairs = zip(BINS, self.count, strict=True)
        return tuple(f"{'xyz'[a]} near {c:+g} g" for (a, c), n in pairs if n < _EACH)

    def offer(self, point: Array) -> bool:
        """Take a mean reading (3,) in g if a bin needs it."""
        for k, (axis, centre) in enumerate(BINS):
            if self.count[k] < _EACH and abs(point[axis] - centre) <= _HALF_WIDTH:
                self.count[k] += 1
                self.points.append(point)
                return True
        return False


def two_sets(means: Array) -> tuple[PointCollector, PointCollector]:
    """A set to calibrate with and a distinct one to verify with, from means (n, 3) in g in order.

    What the first has no room for is offered to the second.
    """
    first, second = PointCollector(), PointCollector()
    for point in means:
        if not first.offer(point):
            second.offer(point)
        if first.ready and second.ready:
            break
    return first, second


class PublishedMethod(Data):
    """One method of the paper on one set of points."""

    p: Annotated[Mapping[str, float], "Of the paper."]
    fitted_mg: Annotated[float, "Mean error on the points that it used."]
    verified_mg: Annotated[float, "Mean error on the second set."]
    improvement_percent: Annotated[float, "R."]


class PublishedDetails(Data, beside=("report", "calibrator", "actigraph")):
    """What the paper's own procedure has to say (--as-published)."""

    methods: Mapping[str, PublishedMethod]
    points_g: Annotated[Array, "To calibrate with."]
    control_points_g: Annotated[Array, "To verify with."]


@dataclass(frozen=True, kw_only=True)
class PublishedRun(Run):
    """The paper's procedure on one recording."""

    details: PublishedDetails
    scanned: Scan


def calibrate_as_published(
    path: Path, mapping: FieldMapping, request: ActigraphRequest, say: Callable[[str], None]
) -> PublishedRun:
    """Collect points from segments of 5 s, descend, verify on a second set of points.

    Raises Undetermined with the bins that stayed empty.
    """
    request = replace(request, window=SECONDS, as_published=True, loop=False)
    scanned = scan(blocks(path, mapping), request.window)
    # At rest are segments whose max - min along x is below 0.12 g, and that are not stuck.
    spread = scanned.windows.high[:, 0] - scanned.windows.low[:, 0]
    still = np.flatnonzero((spread > 0.0) & (spread < RANGE_G * request.gravity))
    points, control = two_sets(scanned.windows.mean[still] / request.gravity)
    say(f"read {scanned.path}: {still.size} segments at rest by the paper's rule")
    if not points.ready:
        raise Undetermined(
            f"{len(points.points)} of 18 points collected; nothing with "
            + ", ".join(points.missing),
            where=scanned.path,
            remedy="record longer, or leave --as-published out: all windows then count",
        )
    first, second = np.array(points.points), np.array(control.points).reshape(-1, 3)
    methods = compare_methods(first, second)
    chosen = methods[ARITHMETIC[request.arithmetic]]
    found = fit_as_published(np.array(list(chosen.p.values())), first, request.gravity)
    error = _error(chosen, found, first, second)
    held = {"max-error": error.held_out.final}  # no other limit has a value here
    outcome = Outcome(
        calibrator="actigraph",
        errors=(error,),
        provenance=provenance(scanned, request),
        fit=found,
        reasons=() if len(second) else ("no second set of points to verify with",),
        limits=tuple(Limit(n, held.get(n, np.nan), v, "mg") for n, v in request.limits.items()),
        notes=scanned.notes,
        sensor=scanned.sensor,
    )
    facts = {"errors": [error.as_dict()], "method": plain(methods)}
    return PublishedRun(
        outcome=outcome,
        calibration=calibration_of(found, outcome, request, facts),
        details=PublishedDetails(methods, first, second),
        scanned=scanned,
    )


def _error(chosen: PublishedMethod, found: Fit, first: Array, second: Array) -> ErrorSummary:
    raw, raw_second = (1e3 * mean_error(START, points) for points in (first, second))
    return ErrorSummary(
        metric="mean error of |a|",
        unit="mg",
        raw=raw,
        base=chosen.fitted_mg,
        final=chosen.fitted_mg,
        floor=found.noise.factor * float(np.sqrt(2.0 / np.pi)),
        held_out=HeldOutError(raw_second, chosen.verified_mg, chosen.verified_mg),
    )


def compare_methods(first: Array, second: Array) -> dict[str, PublishedMethod]:
    """Every method of the paper on the same points (n, 3) g, and verified on a second set."""
    found = {}
    for name, method in METHODS.items():
        p = method(first)
        fitted, verified = (1e3 * mean_error(p, points) for points in (first, second))
        names = dict(zip(_NAMES, map(float, p), strict=True))
        found[name] = PublishedMethod(names, fitted, verified, improvement(p, second))
    return found


def fit_as_published(p: Array, points: Array, gravity: float) -> Fit:
    """The paper's result as a fit: covariance as least squares on these points would have it.

    θ is of bias (mg), scale and non-orthogonality: S = K⁻¹, c = -o for the paper's p.
    """
    model = Model(tuple(named(name) for name in NINE))
    n = len(points)
    data = Observations(
        gravity * points[:, None],
        np.full((n, 1, 3), MG),
        KnownNorm(n, gravity),
        Context(n, {"record": np.arange(n, dtype=float)}),
        np.arange(n, dtype=np.intp),
        tuple(f"point {k + 1}" for k in range(n)),
    )
    gain = np.array([[p[0], 0.0, 0.0], [p[3], p[1], 0.0], [p[4], p[5], p[2]]])
    inner = np.linalg.inv(gain)
    lower = [inner[1, 0], inner[2, 0], inner[2, 1]]
    theta = np.concatenate([-p[6:] * gravity / MG, np.diag(inner) - 1.0, lower])
    rough = evaluate(model, data, theta, np.eye(9))
    inverse = np.linalg.pinv(rough.at.jacobian.T @ rough.at.jacobian, rcond=1e-14)
    return replace(rough, covariance=np.asarray(rough.noise.factor**2 * inverse))
