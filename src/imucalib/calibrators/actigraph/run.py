"""From a recording to an outcome: one pass, posture runs, calibration, judgement."""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from imucalib import __version__
from imucalib.calibration.outcome import Outcome, Provenance
from imucalib.calibrators.actigraph.advice import advice, limits_of, reasons
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.observations import quantisation
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import Series, series, without_found
from imucalib.loop.found import FitLoop
from imucalib.readers import stored_blocks
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.runs import WORN, PostureRuns, Scan, posture_runs, scan
from imucalib.units import MG


@dataclass(frozen=True)
class ActigraphRun:
    """A finished run: the outcome that all calibrators share, and what only `actigraph` reports."""

    outcome: Outcome
    result: ActigraphResult
    scanned: Scan
    request: ActigraphRequest
    series: Series | None = None

    @property
    def runs(self) -> PostureRuns:
        return self.result.runs


def calibrate_recording(
    path: Path, mapping: FieldMapping, request: ActigraphRequest, say: Callable[[str], None]
) -> ActigraphRun:
    """Read in blocks and calibrate; `say` gets a line for each thing worth knowing on the way."""
    scanned = scan(stored_blocks(path, mapping), request.window, request.triad)
    runs = posture_runs(scanned, WORN)
    scanned = scanned.without_windows()
    return run_of(runs, scanned, request, say)


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
    result = calibrate(runs, scanned, request, np.random.default_rng(request.seed))
    result = replace(result, loop=result.loop and with_untestable(result.loop, runs))
    declined = (result.declined,) if result.declined else ()
    outcome = Outcome(
        calibrator="actigraph",
        fit=result.final,
        loop=result.loop,
        error=result.error,
        provenance=provenance_of(scanned, request),
        reasons=reasons(result),
        advice=advice(result),
        limits=limits_of(result, request.limits),
        notes=(*scanned.notes, *runs.notes, *declined),
        weak=result.weak,
    )
    parts = None
    if request.every:
        parts = series(without_found(runs, result.final, request), scanned, request, say)
    return ActigraphRun(outcome, result, scanned, request, parts)


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


def provenance_of(scanned: Scan, request: ActigraphRequest) -> Provenance:
    """Where the numbers come from; enough to compute them again."""
    import scipy

    settings: dict[str, object] = {
        "window_s": request.window,
        "gravity_m_per_s2": request.gravity,
        "gravity_source": request.gravity_source,
        "as_published": request.as_published,
        "declare": list(request.declare),
        "only": list(request.only),
        "without": list(request.without),
        "loop": request.loop,
        "blocks": request.blocks,
        "alpha": request.rules.alpha,
        "draws": request.rules.draws,
    }
    versions = {
        "imucalib": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    return Provenance(
        Path(scanned.path).name,
        scanned.sha256,
        scanned.samples,
        scanned.gaps,
        scanned.mapping,
        settings,
        request.seed,
        versions,
        datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
    )
