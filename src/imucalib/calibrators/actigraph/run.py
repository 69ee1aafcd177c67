"""From a recording to an outcome: one pass, posture runs, calibration, judgement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from imucalib.calibration.outcome import Outcome, Run, left_open, quality_of
from imucalib.calibration.plain import plain
from imucalib.calibration.provenance import Provenance, provenance_of
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.calibration import (
    actigraph_calibration,
    actigraph_details,
    advice,
    limits_of,
    reasons,
)
from imucalib.calibrators.actigraph.errors import Coverage, coverage_of, raw_errors
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import (
    Exchange,
    Series,
    exchange_in,
    series,
    without_found,
)
from imucalib.calibrators.actigraph.wear import (
    Activity,
    ClosestPoint,
    Minutes,
    Wear,
    activity_of,
    closest_point,
    minutes_of,
    wear_of,
)
from imucalib.calibrators.population import not_of_its_kind
from imucalib.errors import Undetermined
from imucalib.readers import blocks, stored_blocks
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.runs import WORN, PostureRuns, Scan, posture_runs, scan
from imucalib.units import MG


@dataclass(frozen=True, kw_only=True)
class ActigraphRun(Run):
    """A finished run: what all calibrators share, and what only its own report shows."""

    result: ActigraphResult
    coverage: Coverage
    scanned: Scan
    request: ActigraphRequest
    series: Series | None = None
    activity: Activity | None = None
    rule: ClosestPoint | None = None

    @property
    def runs(self) -> PostureRuns:
        return self.result.runs


def calibrate_recording(
    path: Path, mapping: FieldMapping, request: ActigraphRequest, say: Callable[[str], None]
) -> ActigraphRun:
    """Read in blocks and calibrate; `say` gets a line for each thing worth knowing on the way."""
    scanned = scan(stored_blocks(path, mapping), request.window, request.triad)
    runs = posture_runs(scanned, WORN)
    wear, rule = wear_of(scanned), closest_point(scanned)
    run = run_of(runs, scanned.without_windows(), request, say)
    minutes = minutes_of(blocks(path, mapping), scanned.triad, run.result.final)
    return with_activity(run, minutes, wear, rule)


def with_activity(
    run: ActigraphRun, minutes: Minutes, wear: Wear, rule: ClosestPoint | None
) -> ActigraphRun:
    """The run with what its calibration does to wear and activity, beside the field's rule."""
    errors = [h.error[:, 0, 0] for h in (raw_errors(run.result.base), run.result.final_held)]
    start = (run.scanned.start_ns or 0) / 1e9 % 86400.0
    activity = activity_of(minutes, wear, start, (errors[0], errors[1]), run.runs.time)
    block = plain({"activity": activity.as_dict(), "ggir_rule": rule and rule.as_dict()})
    return replace(run, activity=activity, rule=rule, details={**run.details, **block})


def run_of(
    runs: PostureRuns, scanned: Scan, request: ActigraphRequest, say: Callable[[str], None]
) -> ActigraphRun:
    """Calibrate posture runs that are already there."""
    say(
        f"read {scanned.path} ({scanned.format}, {scanned.stop / 3600.0:.1f} h at "
        f"{scanned.rate:g} Hz): {runs.still} still windows in {runs.n} posture runs"
    )
    for text in (*scanned.notes, *runs.notes):
        say(f"  {text}")
    exchange = _exchange(runs, scanned, request)
    if exchange is not None:
        say(f"  {exchange.words}")
    result = _with_untestable(calibrate(runs, scanned, request))
    coverage = coverage_of(
        runs,
        scanned,
        result.final,
        gravity=request.gravity,
        window=request.window,
        downweighted=result.downweighted,
    )
    said = result.of_a_kind
    outcome = Outcome(
        calibrator="actigraph",
        errors=(result.error,),
        provenance=provenance(scanned, request),
        findings=request.findings(result.loop),
        quality=quality_of(result.final),
        reasons=(
            *((exchange.words,) if exchange else ()),
            *runs.faults,
            *reasons(result, coverage),
        ),
        advice=advice(result, coverage),
        limits=limits_of(result, request.limits),
        notes=(*scanned.notes, *runs.notes),
        undecided=not_of_its_kind(
            said.chance if said else float("nan"),
            "calibrated without --fleet: is it another kind, or was it turned?",
        ),
        weak=result.weak,
        left=left_open(result.loop, result.error),
    )
    parts = None
    if request.every:
        parts = series(without_found(runs, result.final, request), scanned, request, say)
    details = actigraph_details(result, coverage, parts)
    return ActigraphRun(
        outcome=outcome,
        calibration=actigraph_calibration(outcome, result, scanned, request, details, parts),
        details=details,
        result=result,
        coverage=coverage,
        scanned=scanned,
        request=request,
        series=parts,
    )


def _exchange(runs: PostureRuns, scanned: Scan, request: ActigraphRequest) -> Exchange | None:
    """Where the sensor is another one. Raises Undetermined where that ends the one calibration that
    was wanted."""
    found = exchange_in(runs)
    if found is not None and request.every is None:
        raise Undetermined(
            found.words,
            where=scanned.path,
            remedy=f"each sensor needs its own calibration: --every {found.time / 3600.0:.2f}h "
            "calibrates the parts before and after by themselves",
        )
    return found


def _with_untestable(result: ActigraphResult) -> ActigraphResult:
    """The search with what it could not test on this sensor's readings, whatever the postures."""
    size, loop = quantisation(result.runs), result.loop
    if size == 0.0 or loop is None:
        return result
    why = (
        f"a step of {float(result.runs.resolution.max()) / MG:.2g} mg hides the noise, so no curve "
        f"of that period can be told from it: {size / MG:.2g} mg stays in each posture's "
        "uncertainty"
    )
    return replace(result, loop=replace(loop, missing={**loop.missing, "quantisation": why}))


def provenance(scanned: Scan, request: ActigraphRequest) -> Provenance:
    """Where the numbers come from."""
    return provenance_of(
        path=scanned.path,
        sha256=scanned.sha256,
        samples=scanned.samples,
        gaps=scanned.gaps,
        mapping=scanned.mapping,
        settings=request.stated(),
        seed=request.seed,
        command=request.command,
    )
