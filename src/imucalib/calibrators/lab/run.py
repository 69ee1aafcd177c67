"""From a position table to an outcome: checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Index
from imucalib.calibration.outcome import Outcome, Run, left_open, quality_of
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.lab.advice import advice, fix_option, limits_of, reasons
from imucalib.calibrators.lab.bench import (
    RawUnit,
    implausible_rows,
    in_celsius,
    kept_rows,
    observations_of,
    raw_unit,
    refuse_units,
    row_numbers,
)
from imucalib.calibrators.lab.calibrate import LabResult, calibrate
from imucalib.calibrators.lab.calibration import lab_calibration, lab_details
from imucalib.calibrators.lab.faults import Faults, doubts, look_for_faults, worthless
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import repaired
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.sessions import Sessions, sessions_of
from imucalib.calibrators.population import not_of_its_kind
from imucalib.core.observations import Observations
from imucalib.errors import NotConverged, Undetermined, UnreadableInput, UsageError
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
    """Calibrate a position table. Errors as in `calibrate`; UsageError for swapped angles.

    mapping : how the recording was read whose rests the readings are, None for a table's own
    """
    table, emptied = repaired(table, request.repairs, request.fixes, request.swap_angles)
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    if mapping is not None:
        raw = replace(raw, sentence="m/s², as the recording was read")
    table = in_celsius(table)
    whole = observations_of(table, raw, request)
    rows, excluded = _kept(table, request, emptied)
    result, faults = _judged(table, whole, rows, request, first=True)
    bad = _wrong_rows(result, faults, rows, table) if request.auto_exclude else {}
    if bad:
        excluded += tuple(bad.values())
        rows = np.setdiff1d(rows, list(bad))
        result, faults = _judged(table, whole, rows, request, first=False)
    undecided = _undecided(result, faults, raw, request)
    outcome = Outcome(
        calibrator="lab",
        errors=(result.error,),
        provenance=provenance_of(
            path=table.path,
            sha256=table.sha256,
            parts=table.files,
            samples=table.n,
            gaps=gaps,
            mapping=dict(table.names) if mapping is None else mapping,
            settings={**request.stated(), "unit": raw.name},
            seed=request.seed,
            command=request.command,
        ),
        findings=request.findings(result.loop),
        quality=quality_of(result.final),
        reasons=reasons(result) + worthless(result, whole),
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=(raw.sentence, *table.left_out, *faults.notes, *notes),
        left=left_open(result.loop, result.error),
    )
    sessions = sessions_of(result.final, table.sessions)
    details = lab_details(result, excluded, undecided, faults, sessions)
    return LabRun(
        outcome=outcome,
        calibration=lab_calibration(outcome, result, raw, details),
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


def _kept(
    table: PositionTable, request: LabRequest, emptied: tuple[int, ...]
) -> tuple[Index, tuple[str, ...]]:
    """The rows that were not excluded and have a plausible size, and what was left out."""
    rows = kept_rows(table, (*request.exclude, *emptied))
    refuse_units(table, rows)
    bad = implausible_rows(table, rows, refuse=not request.auto_exclude)
    said = [f"row {r}: excluded as asked" for r in request.exclude]
    said += [f"row {r}: left without a value by --shift" for r in emptied]
    said += [f"row {table.row[k]}: excluded automatically ({why})" for k, why in bad.items()]
    return np.setdiff1d(rows, list(bad)), tuple(said)


def _judged(
    table: PositionTable, whole: Observations, rows: Index, request: LabRequest, *, first: bool
) -> tuple[LabResult, Faults]:
    """The calibration of the sheet as it is, and its slips of hand; at first without a search where
    a whole column is in the wrong place, which physics would explain. What cannot be fitted at all
    ends with what to paste."""
    faults, kept = look_for_faults(table, whole, rows, request), whole.take(rows)
    faulty = first and bool(faults.slips)
    tried = replace(request, loop=False) if faulty else request
    train = None
    if request.train:
        train = np.flatnonzero(np.isin(row_numbers(kept), request.train))
        if train.size == 0:
            raise UsageError("--train names no row that is left")
    try:
        result = calibrate(kept, tried, train=train, written=faults.written, faulty=faulty)
    except (NotConverged, Undetermined, UnreadableInput) as error:
        if not faulty:
            faults.with_axes(request)  # which may say why
        if not faulty or isinstance(error, Undetermined):
            raise
        raise UnreadableInput(
            "; ".join(f.what for f in faults.slips),
            where=error.where,
            remedy=" ".join(f.line for f in faults.slips),
        ) from error
    slips = (*faults.slips, *(result.loop.slips if result.loop else ()))
    return result, replace(faults, slips=slips).with_axes(request)


def _undecided(
    result: LabResult, faults: Faults, raw: RawUnit, request: LabRequest
) -> tuple[str, ...]:
    """What only the user can decide: slips and wrong records, else doubts; a fleet's too."""
    found = faults.undecided(_records(result))
    found += tuple(
        f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others predict "
        f"({r.likely}, {per_cent(r.probability)}); decide with {fix_option(r, raw)}"
        for r in _records(result)
    )
    instead = "calibrate it alone, in 24 positions or more, without --fleet"
    return (found or doubts(result, raw, request)) + not_of_its_kind(result.kind_chance, instead)


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


def _records(result: LabResult) -> tuple[RecordError, ...]:
    return result.loop.records if result.loop else ()
