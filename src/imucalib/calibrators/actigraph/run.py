"""From a recording to an outcome: one pass, posture runs, calibration, judgement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from imucalib.calibration.findings import Findings, findings_of
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
from imucalib.calibrators.actigraph.closest_point import ClosestPoint, closest_point
from imucalib.calibrators.actigraph.coverage import Coverage, coverage_of
from imucalib.calibrators.actigraph.errors import raw_errors
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import (
    Exchange,
    Series,
    exchange_in,
    refuse_exchange,
    series,
    without_found,
)
from imucalib.calibrators.actigraph.wear import (
    Activity,
    Minutes,
    Wear,
    activity_of,
    minutes_of,
    wear_of,
)
from imucalib.calibrators.population import not_of_its_kind
from imucalib.loop.found import FitLoop
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
    exchange = exchange_in(runs)
    refuse_exchange(exchange, scanned.path, parts=request.every is not None)
    if exchange is not None:
        say(f"  {exchange.words}")
    result = calibrate(runs, scanned, request)
    result = replace(result, loop=result.loop and with_untestable(result.loop, runs))
    coverage = coverage_of(result, scanned, gravity=request.gravity, window=request.window)
    outcome = _judged(result, coverage, scanned, request, exchange)
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


def _judged(
    result: ActigraphResult,
    coverage: Coverage,
    scanned: Scan,
    request: ActigraphRequest,
    exchange: Exchange | None,
) -> Outcome:
    said = result.of_a_kind
    return Outcome(
        calibrator="actigraph",
        errors=(result.error,),
        provenance=provenance(scanned, request),
        findings=_findings(result.loop, request),
        quality=quality_of(result.final),
        reasons=(
            *((exchange.words,) if exchange else ()),
            *result.runs.faults,
            *reasons(result, coverage),
        ),
        advice=advice(result, coverage),
        limits=limits_of(result, request.limits),
        notes=(*scanned.notes, *result.runs.notes),
        undecided=()
        if said is None
        else not_of_its_kind(
            said.strange, "calibrated without --fleet: is it another kind, or was it turned?"
        ),
        weak=result.weak,
        left=left_open(result.loop, result.error),
    )


def _findings(loop: FitLoop | None, request: ActigraphRequest) -> Findings | None:
    if loop is None:
        return None
    return findings_of(loop, declared=request.declare, only=request.only, without=request.without)


def with_untestable(loop: FitLoop, runs: PostureRuns) -> FitLoop:
    """The search with what it could not test on this sensor's readings, whatever the postures."""
    size = quantisation(runs)
    if size == 0.0:
        return loop
    why = (
        f"a step of {float(runs.resolution.max()) / MG:.2g} mg hides the noise, so no curve of "
        f"that period can be told from it: {size / MG:.2g} mg stays in each posture's uncertainty"
    )
    return replace(loop, missing={**loop.missing, "quantisation": why})


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
