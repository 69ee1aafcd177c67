"""From a file to an outcome: reading, checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.findings import Findings, findings_of
from imucalib.calibration.outcome import Outcome, Run, quality_of
from imucalib.calibration.provenance import Provenance, provenance_of
from imucalib.calibrators.lab.advice import advice, fix_option, limits_of, reasons
from imucalib.calibrators.lab.bench import RawUnit, corrected_cells, raw_unit, swapped_angles
from imucalib.calibrators.lab.calibrate import LabResult, LabSettings, calibrate
from imucalib.calibrators.lab.calibration import lab_calibration, lab_details
from imucalib.calibrators.lab.checks import (
    implausible_sizes,
    kept_rows,
    observations_of,
    refuse_sizes,
    refuse_swapped,
    with_train,
)
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.observations import Observations
from imucalib.loop.found import FitLoop
from imucalib.loop.record_errors import RecordError

Index = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class LabRun(Run):
    """A finished run: what all calibrators share, and what only the report of `lab` shows."""

    result: LabResult
    table: PositionTable
    raw: RawUnit
    request: LabRequest
    excluded: tuple[str, ...]


def run_lab(
    table: PositionTable,
    request: LabRequest,
    *,
    mapping: Mapping[str, object] | None = None,
    gaps: int = 0,
    notes: tuple[str, ...] = (),
) -> LabRun:
    """Calibrate a position table. Errors as in `calibrate`; UsageError for swapped angles."""
    table = corrected_cells(table, request.fixes)
    table = swapped_angles(table) if request.swap_angles else table
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    whole = observations_of(table, raw, request)
    if request.reference == "vector" and not request.keep_angles:
        refuse_swapped(whole, table, raw, request)
    rows, excluded = _kept(table, request)
    result = _calibrated(whole, rows, request)
    if request.auto_exclude and _records(result):
        excluded += tuple(
            f"{r.where}: excluded automatically "
            f"({r.channel} off by {r.size:.3g} {r.unit}, {r.likely})"
            for r in _records(result)
        )
        bad = rows[result.used[[r.row for r in _records(result)]]]
        rows = np.setdiff1d(rows, bad)
        result = _calibrated(whole, rows, request)
    undecided = tuple(
        f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others predict "
        f"({r.likely}); decide with {fix_option(r, raw)}"
        for r in _records(result)
    )
    provenance = _provenance(table, raw, request, mapping or dict(table.names), gaps)
    outcome = _judged(result, raw, request, provenance, undecided, (raw.sentence, *notes))
    details = lab_details(result, excluded)
    return LabRun(
        outcome=outcome,
        calibration=lab_calibration(outcome, result, raw, request, details),
        details=details,
        result=result,
        table=table,
        raw=raw,
        request=request,
        excluded=excluded,
    )


def _judged(
    result: LabResult,
    raw: RawUnit,
    request: LabRequest,
    provenance: Provenance,
    undecided: tuple[str, ...],
    notes: tuple[str, ...],
) -> Outcome:
    return Outcome(
        calibrator="lab",
        errors=(result.error,),
        provenance=provenance,
        findings=_findings(result.loop, result.settings),
        quality=quality_of(result.final),
        reasons=reasons(result, raw),
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=notes,
    )  # fmt: skip


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
        samples=table.n,
        gaps=gaps,
        mapping=mapping,
        settings={**request.stated(), "unit": raw.name},
        seed=request.seed,
        command=request.command,
    )


def _kept(table: PositionTable, request: LabRequest) -> tuple[Index, tuple[str, ...]]:
    """The rows that were not excluded and have a plausible size, and what was left out."""
    rows = kept_rows(table, request.exclude)
    far = implausible_sizes(table, rows)
    if not request.auto_exclude:
        refuse_sizes(table, far, rows)
    asked = tuple(f"row {r}: excluded as asked" for r in request.exclude)
    words = tuple(f"row {r + 1}: excluded automatically (size of |a|)" for r in far)
    return np.setdiff1d(rows, far), asked + words


def _calibrated(whole: Observations, rows: Index, request: LabRequest) -> LabResult:
    rng = np.random.default_rng(request.seed)
    return calibrate(whole.take(rows), with_train(request, rows), rng)


def _records(result: LabResult) -> tuple[RecordError, ...]:
    return result.loop.records if result.loop else ()
