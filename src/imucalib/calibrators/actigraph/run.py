"""From a recording to an outcome: one pass, posture runs, calibration, judgement."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from imucalib.calibration import sums
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.findings import advice_of, find_hidden
from imucalib.calibration.outcome import Limit, Outcome, Provenance, Run, list_open, provenance_of
from imucalib.calibration.series import series_facts
from imucalib.calibrators.actigraph.calibrate import ActigraphResult, calibrate
from imucalib.calibrators.actigraph.errors import (
    Coverage,
    SphereCell,
    coverage_of,
    mean_error,
    sphere_cells,
)
from imucalib.calibrators.actigraph.observations import from_data, open_words, quantisation
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.series import (
    CalibrationSeries,
    Exchange,
    SeriesFacts,
    describe_series,
    exchange_in,
    series,
    undo_found,
)
from imucalib.calibrators.actigraph.wear import (
    Activity,
    ClosestPoint,
    activity_of,
    closest_point,
    minutes_of,
    wear_of,
)
from imucalib.calibrators.next_recording import describe_recorded
from imucalib.calibrators.population import not_of_its_kind
from imucalib.core.effect import CLOCKS
from imucalib.core.fit import Fit
from imucalib.core.sphere import count_by_cell
from imucalib.data import Data
from imucalib.effects.forms import in_words
from imucalib.errors import Undetermined
from imucalib.posterior.held_out import raw_errors
from imucalib.readers import blocks, blocks_again
from imucalib.recording.mapping import FieldMapping
from imucalib.rests.runs import WORN, PostureRuns, Scan, posture_runs, scan
from imucalib.units import MG

#: The field calls a calibration good below this error (mg); a tenth of it is well known.
_GOOD, _WELL_KNOWN = 10.0, 1.0
#: What to do about what moves with time where no temperature was recorded, and where no cause is
#: proved.
_COLD = (
    "The error moves with time and no temperature was recorded: export the temperature channel "
    "too, or calibrate in parts with --every 1d."
)
_UNPROVED = (
    "The error moves with time, in too few stretches to prove a cause: --every 6h shows which "
    "parts differ, a longer recording whether it comes back."
)
_UNSEARCHED = "What the nine parameters lack was not searched for: that takes {}."


class MeanError(Data):
    """The field's measure, mg."""

    metric: str
    raw: float
    base_fitted: float
    final_fitted: float
    base_held_out: float
    final_held_out: float
    base_held_out_rms: float
    final_held_out_rms: float
    held_out_blocks: Annotated[int, "Of time, each predicted without it."]


class ActigraphDetails(Data, beside=("report", "calibrator", "actigraph")):
    """What only a worn sensor has to say."""

    error_mg: MeanError
    coverage: Coverage
    from_data: Annotated[Mapping[str, float], "Share of each parameter that the data tell."]
    sphere: tuple[SphereCell, ...]
    series: Annotated[SeriesFacts | None, "With --every."] = None
    effects_beside_base: Annotated[Mapping[str, Any] | None, "Products for a fleet."] = None
    record_next: Annotated[Mapping[str, Any] | None, "What `imucal design --separate` reads."] = (
        None
    )
    activity: Annotated[Activity | None, "Where the samples were seen."] = None
    ggir_rule: Annotated[ClosestPoint | None, "Where it had windows enough."] = None


@dataclass(frozen=True, kw_only=True)
class ActigraphRun(Run):
    """A finished run: what all calibrators share, and what only its own report shows."""

    details: ActigraphDetails
    result: ActigraphResult
    scanned: Scan
    request: ActigraphRequest
    series: CalibrationSeries | None = None

    @property
    def runs(self) -> PostureRuns:
        return self.result.runs


def calibrate_recording(
    path: Path, mapping: FieldMapping, request: ActigraphRequest, say: Callable[[str], None]
) -> ActigraphRun:
    """Read in blocks and calibrate; `say` gets a line for each thing worth knowing on the way."""
    scanned = scan(blocks(path, mapping), request.window)
    runs = posture_runs(scanned, WORN)
    wear, rule = wear_of(scanned), closest_point(scanned)
    run = run_of(runs, scanned.drop_windows(), request, say)
    again = blocks_again(path, mapping, f"{scanned.triad}/acceleration")
    minutes = minutes_of(again, scanned.triad, run.result.final)
    raw, corrected = (
        h.error[:, 0, 0] for h in (raw_errors(run.result.base), run.result.final_held)
    )
    start = (scanned.start_ns or 0) / 1e9 % 86400.0
    activity = activity_of(minutes, wear, start, (raw, corrected), runs.time)
    return replace(run, details=replace(run.details, activity=activity, ggir_rule=rule))


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
        fit=result.final,
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
        left=list_open(result.loop, result.error),
        sensor=scanned.sensor,
    )
    parts = None
    if request.every:
        parts = series(undo_found(runs, result.final, request), scanned, request, say)
    details = actigraph_details(result, coverage, parts)
    return ActigraphRun(
        outcome=outcome,
        calibration=actigraph_calibration(outcome, result, scanned, request, details, parts),
        details=details,
        result=result,
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
        settings=request.describe_settings(),
        seed=request.seed,
        command=request.command,
    )


def reasons(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """Why the calibration is not simply good."""
    found = [_coverage_words(result, coverage)] if result.weak else []
    held, raw = mean_error(result.final_held), result.error.held_out.raw
    if coverage.norm_sd_largest_mg > _WELL_KNOWN and not result.weak:
        ends = ", ".join(coverage.never)
        where = f"; no posture with {ends}" if ends else ""
        found.append(
            "the error in some directions is known to "
            f"{coverage.norm_sd_largest_mg:.1f} mg only{where}"
        )
    if held > _GOOD:
        found.append(f"the held-out error of {held:.2f} mg is above the field's 10 mg")
    if held > raw:
        found.append(f"on held-out time it is no better than no calibration ({raw:.2f} mg)")
    return tuple(found)


def _coverage_words(result: ActigraphResult, coverage: Coverage) -> str:
    """What weak coverage of the sphere leaves open, in the field's terms."""
    count = f"{result.runs.n} posture run" + "s" * (result.runs.n != 1)
    never = f" (never {', '.join(coverage.never)})" if coverage.never else ""
    text = f"weak coverage of the sphere: {count}{never} leave open {open_words(result.base)}"
    if result.with_fleet:
        text += "; what is open stays as devices of its kind have it"
    elif result.base.prior is not None:
        text += "; what is open stays near its nominal value, with a data sheet's uncertainty"
    return f"{text}; |a| is known to {coverage.norm_sd_largest_mg:.1f} mg in the worst direction"


def advice(result: ActigraphResult, coverage: Coverage) -> tuple[str, ...]:
    """The next steps, most useful first."""
    found, loop = [], result.loop
    if coverage.norm_sd_largest_mg > _WELL_KNOWN:
        ends = ", ".join(coverage.never)
        found.append(
            f"Rest the sensor for ten seconds with {ends}, or record more nights."
            if ends
            else "More postures at rest, in new directions, make the parameters better known."
        )
    if result.with_fleet:
        found.append("What the model lacks is not searched for beside a fleet.")
    elif result.weak and loop is None:
        found.append(_UNSEARCHED.format("postures which determine all of them"))
    elif result.few:
        found.append(_UNSEARCHED.format("twice as many posture runs as parameters"))
    if loop is None:
        return tuple(found)
    kinds = {u.kind for u in loop.unexplained if u.driver in CLOCKS}
    if kinds and "temperature" not in result.final.observations.context:
        found.append(_COLD)
    elif "probe" in kinds:
        found.append(_UNPROVED)
    if loop.steps and (step := loop.steps[0]).aliases:
        name = in_words(step.effect)
        found.append(
            f"{name[0].upper()}{name[1:]} cannot be told from "
            f"{', '.join(map(in_words, step.aliases))}: "
            "both correct this recording alike; a longer one, with more postures, separates them."
        )
    found += advice_of(find_hidden(loop.scores, loop.final.model.names))
    return tuple(found)


def limits_of(result: ActigraphResult, limits: Mapping[str, float]) -> tuple[Limit, ...]:
    """The user's limits against what was found."""
    value = {
        "max-error": mean_error(result.final_held),
        "max-worst-error": float(np.abs(result.final_held.error).max()) / MG,
    }
    return tuple(Limit(name, value[name], limit, "mg") for name, limit in limits.items())


def actigraph_calibration(
    outcome: Outcome,
    result: ActigraphResult,
    scanned: Scan,
    request: ActigraphRequest,
    details: ActigraphDetails,
    parts: CalibrationSeries | None,
) -> Calibration:
    """The calibration of a run's final fit."""
    final = result.final
    # What one posture scatters by when it comes again.
    sigma = final.noise.factor * float(np.median(final.at.sigma)) / MG
    facts: dict[str, Any] = {
        "frame": "x keeps its direction; gravity alone cannot see a rotation of the frame",
        "clock": {"start_ns": scanned.start_ns, "span_s": max(scanned.stop, 1.0)},
        "errors": [error.as_dict() for error in outcome.errors],
        "error_mg": details.error_mg.as_dict(),
        "noise": {"reading_mg": sigma, "reading_sd_mg": sigma * float(final.noise_sd[0])},
        "coverage": details.coverage.as_dict(),
        "postures": count_by_cell(final.observations.reading[:, 0]).tolist(),
        "from_data": details.from_data,
    }
    whole = calibration_of(final, outcome, request, facts)
    if parts is None:
        return whole
    fits = [(part.start, part.stop, part.fit) for part in parts.parts]
    compared = series_facts(whole, fits, differ=parts.differ)
    return replace(whole, facts={**whole.facts, **compared})


def calibration_of(
    fit: Fit, outcome: Outcome, request: ActigraphRequest, facts: Mapping[str, Any]
) -> Calibration:
    """The calibration of a fit of readings in m/s², with its facts between those that every one of
    a worn sensor has."""
    return from_fit(
        fit,
        "actigraph",
        raw_unit="m/s2",
        raw_to_si=1.0,
        gravity=request.gravity,
        status=outcome.status,
        reasons=outcome.reasons,
        facts={
            "gravity_source": request.gravity_source,
            **facts,
            "provenance": outcome.provenance.as_dict(),
        },
        sensor=outcome.sensor,
    )


def actigraph_details(
    result: ActigraphResult, coverage: Coverage, parts: CalibrationSeries | None
) -> ActigraphDetails:
    """What only a worn sensor has to say; its samples are seen later."""
    final, loop, error = result.final, result.loop, result.error
    shares = zip(final.parameters, from_data(final), strict=True)
    recorded = products = None
    if loop is not None and loop.drift is not None:
        products = sums.sums_block(loop.sums) if loop.sums else None
        recorded = describe_recorded(
            final,
            loop.ambiguous,
            reading=MG * loop.drift.scatter,
            settings={},
            drift=loop.drift.sd,
        )
    return ActigraphDetails(
        error_mg=MeanError(
            metric="mean absolute error of the norm over posture runs",
            raw=error.raw,
            base_fitted=error.base,
            final_fitted=error.final,
            base_held_out=error.held_out.base,
            final_held_out=error.held_out.final,
            base_held_out_rms=result.base_held.rms() / MG,
            final_held_out_rms=result.final_held.rms() / MG,
            held_out_blocks=int(np.unique(final.observations.group).size),
        ),
        coverage=coverage,
        from_data={p.name: float(v) for p, v in shares},
        sphere=sphere_cells(result.base, final, result.final_held),
        series=None if parts is None else describe_series(parts),
        effects_beside_base=products,
        record_next=recorded,
    )
