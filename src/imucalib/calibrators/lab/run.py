"""From a file to an outcome: reading, checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibration.findings import Findings, findings_of
from imucalib.calibration.outcome import Outcome, Run, left_open, quality_of
from imucalib.calibration.provenance import Provenance, provenance_of
from imucalib.calibrators.lab.advice import (
    advice,
    fix_option,
    limits_of,
    reasons,
)
from imucalib.calibrators.lab.bench import RawUnit, raw_unit, row_numbers
from imucalib.calibrators.lab.calibrate import LabResult, LabSettings, calibrate
from imucalib.calibrators.lab.calibration import lab_calibration, lab_details
from imucalib.calibrators.lab.checks import (
    implausible_sizes,
    kept_rows,
    observations_of,
    refuse_sizes,
    refuse_temperatures,
    refuse_units,
    warmth_note,
    with_train,
    without_temperature,
)
from imucalib.calibrators.lab.faults import Faults, doubts, look_for_faults, worthless
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import repaired
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.sessions.between import Sessions, sessions_of
from imucalib.calibrators.population import not_of_its_kind
from imucalib.core.observations import Observations
from imucalib.errors import NotConverged, Undetermined, UnreadableInput
from imucalib.loop.found import FitLoop
from imucalib.loop.record_errors import RecordError
from imucalib.significant_digits import per_cent


@dataclass(frozen=True, kw_only=True)
class LabRun(Run):
    """A finished run: what all calibrators share, and what only the report of `lab` shows.

    recorded : the readings are a recording's rests, and no table's
    """

    result: LabResult
    table: PositionTable
    raw: RawUnit
    request: LabRequest
    excluded: tuple[str, ...]
    faults: Faults
    recorded: bool = False
    sessions: Sessions | None = None


def run_lab(
    table: PositionTable,
    request: LabRequest,
    *,
    mapping: Mapping[str, object] | None = None,
    gaps: int = 0,
    notes: tuple[str, ...] = (),
) -> LabRun:
    """Calibrate a position table. Errors as in `calibrate`; UsageError for swapped angles."""
    table, lost = repaired(table, request.repairs, request.fixes, request.swap_angles)
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    if mapping is not None:
        raw = replace(raw, sentence="m/s², as the recording was read")
    whole = observations_of(table, raw, request)
    rows, excluded = _kept(table, request, lost)
    faults = look_for_faults(table, raw, whole, rows, request)
    result = _first(whole, rows, request, faults)
    faults = faults.found_in(result.loop).of_axes(request)
    bad = _wrong_rows(result, faults, rows, table) if request.auto_exclude else {}
    if bad:
        excluded += tuple(bad.values())
        rows = np.setdiff1d(rows, list(bad))
        faults = look_for_faults(table, raw, whole, rows, request)
        result = _calibrated(whole, rows, request, faults)
        faults = faults.found_in(result.loop).of_axes(request)
    undecided = _undecided(result, faults, raw) or doubts(result, raw, request)
    undecided += not_of_its_kind(
        result.strange, "calibrate it alone, in 24 positions or more, without --fleet"
    )
    outcome = _judged(
        result=result,
        raw=raw,
        request=request,
        provenance=_provenance(table, raw, request, mapping or dict(table.names), gaps),
        undecided=undecided,
        why=reasons(result, raw) + worthless(result, whole),
        notes=(raw.sentence, *warmth_note(table), *table.left_out, *faults.notes, *notes),
    )
    sessions = sessions_of(result.final, table.sessions)
    details = lab_details(result, excluded, undecided, faults, sessions)
    return LabRun(
        outcome=outcome,
        calibration=lab_calibration(outcome, result, raw, request, details),
        details=details,
        result=result,
        table=table,
        raw=raw,
        request=request,
        excluded=excluded,
        faults=faults,
        recorded=mapping is not None,
        sessions=sessions,
    )


def _wrong_rows(
    result: LabResult, faults: Faults, rows: Index, table: PositionTable
) -> dict[int, str]:
    """Rows (from 0) that are wrong one by one, by the search or as slips of hand, and why."""
    by_search = {
        int(rows[result.used[r.row]]): f"{r.where}: excluded automatically "
        f"({r.channel} off by {r.size:.3g} {r.unit}, {r.likely})"
        for r in _records(result)
    }
    by_hand = {
        table.at(f.rows[0]): f"{f.what}; excluded automatically"
        for f in faults.slips
        if f.kind in ("cell", "angle", "record")
    }
    return by_hand | by_search


def _undecided(result: LabResult, faults: Faults, raw: RawUnit) -> tuple[str, ...]:
    return faults.undecided(_records(result)) + tuple(
        f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others predict "
        f"({r.likely}, {per_cent(r.probability)}); decide with {fix_option(r, raw)}"
        for r in _records(result)
    )


def _judged(
    result: LabResult,
    raw: RawUnit,
    request: LabRequest,
    provenance: Provenance,
    undecided: tuple[str, ...],
    why: tuple[str, ...],
    notes: tuple[str, ...],
) -> Outcome:
    return Outcome(
        calibrator="lab",
        errors=(result.error,),
        provenance=provenance,
        findings=_findings(result.loop, result.settings),
        quality=quality_of(result.final),
        reasons=why,
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=notes,
        left=left_open(result.loop, result.error),
    )


def _findings(loop: FitLoop | None, chosen: LabSettings) -> Findings | None:
    if loop is None:
        return None
    return findings_of(loop, declared=chosen.declare, only=chosen.only, without=chosen.without)


def _provenance(
    table: PositionTable,
    raw: RawUnit,
    request: LabRequest,
    mapping: Mapping[str, object],
    gaps: int,
) -> Provenance:
    return provenance_of(
        path=table.path,
        sha256=table.sha256,
        parts=table.files,
        samples=table.n,
        gaps=gaps,
        mapping=mapping,
        settings={**request.stated(), "unit": raw.name},
        seed=request.seed,
        command=request.command,
    )


def _kept(
    table: PositionTable, request: LabRequest, lost: tuple[int, ...]
) -> tuple[Index, tuple[str, ...]]:
    """The rows that were not excluded and have a plausible size, and what was left out."""
    rows = kept_rows(table, (*request.exclude, *lost))
    refuse_units(table, rows)
    far, cold = implausible_sizes(table, rows), without_temperature(table, rows)
    if not request.auto_exclude:
        refuse_sizes(table, far, rows)
        refuse_temperatures(table, cold)
    asked = tuple(f"row {r}: excluded as asked" for r in request.exclude)
    asked += tuple(f"row {r}: left without a value by --shift" for r in lost)
    words = tuple(f"row {table.row[r]}: excluded automatically (size of |a|)" for r in far)
    words += tuple(f"row {table.row[r]}: excluded automatically (no temperature)" for r in cold)
    return np.setdiff1d(rows, [*far, *cold]), asked + words


def _first(whole: Observations, rows: Index, request: LabRequest, faults: Faults) -> LabResult:
    """The calibration of the sheet as it stands; without a search where a whole column stands in
    the wrong place, which physics would explain. What cannot be fitted at all ends with what to
    paste."""
    if not faults.slips:
        try:
            return _calibrated(whole, rows, request, faults)
        except (NotConverged, Undetermined, UnreadableInput):
            faults.of_axes(request)  # which may say why
            raise
    settings = replace(request.settings, loop=False)
    try:
        return _calibrated(whole, rows, replace(request, settings=settings), faults, faulty=True)
    except (NotConverged, UnreadableInput) as error:
        raise UnreadableInput(
            "; ".join(f.what for f in faults.slips),
            where=error.where,
            remedy=" ".join(f.line for f in faults.slips),
        ) from error


def _calibrated(
    whole: Observations, rows: Index, request: LabRequest, faults: Faults, *, faulty: bool = False
) -> LabResult:
    kept = whole.take(rows)
    settings = with_train(request, row_numbers(kept))
    return calibrate(kept, settings, written=faults.written, faulty=faulty)


def _records(result: LabResult) -> tuple[RecordError, ...]:
    return result.loop.records if result.loop else ()
