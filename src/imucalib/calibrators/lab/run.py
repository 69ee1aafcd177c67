"""From a position table to an outcome: checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from imucalib.arrays import Index
from imucalib.calibration.ambiguity import KEY
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.outcome import Outcome, Run, left_open
from imucalib.calibration.provenance import provenance_of
from imucalib.calibrators.lab.advice import (
    advice,
    limits_of,
    reasons,
    settle,
    undecided_parts,
)
from imucalib.calibrators.lab.bench import (
    RawUnit,
    implausible_rows,
    in_celsius,
    kept_rows,
    observations_of,
    raw_unit,
    refuse_dead_axis,
    refuse_units,
    row_numbers,
)
from imucalib.calibrators.lab.calibrate import LabResult, calibrate
from imucalib.calibrators.lab.dial import dial_of
from imucalib.calibrators.lab.errors import (
    attitude_errors,
    reading_noise,
    rms,
    setting_noise,
    worst,
)
from imucalib.calibrators.lab.faults import Faults, doubts, look_for_faults, worthless
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import repair
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.sessions import sessions_of
from imucalib.calibrators.next_recording import recorded_block
from imucalib.calibrators.population import not_of_its_kind
from imucalib.calibrators.sessions import Sessions
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.references import KnownVector
from imucalib.errors import NotConverged, Undetermined, UnreadableInput, UsageError
from imucalib.loop.held_out import errors
from imucalib.loop.record_errors import RecordError
from imucalib.loop.separation import ambiguities
from imucalib.question import Question
from imucalib.recording.identity import Identity
from imucalib.significant_digits import per_cent
from imucalib.units import DEG, MG


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
    table, emptied = repair(table, request.repairs, request.fixes, request.swap_angles)
    raw = raw_unit(table, request.unit, request.lsb_per_g)
    if mapping is not None:
        raw = replace(raw, sentence="m/s², as the recording was read")
    whole = observations_of(table := in_celsius(table), raw, request)
    rows, excluded = _select_rows(table, request, emptied)
    result, faults = _fit_and_look_for_slips(table, whole, rows, request, first=True)
    bad = _wrong_rows(result, faults, rows, table) if request.auto_exclude else {}
    if bad:
        excluded += tuple(bad.values())
        rows = np.setdiff1d(rows, list(bad))
        result, faults = _fit_and_look_for_slips(table, whole, rows, request, first=False)
    undecided = _questions(result, faults, raw, request)
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
        fit=result.final,
        reasons=reasons(result) + worthless(result, whole),
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=(raw.sentence, *table.left_out, *faults.notes, *notes),
        left=left_open(result.loop, result.error),
        sensor=_sensor(table, raw),
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


def _select_rows(
    table: PositionTable, request: LabRequest, emptied: tuple[int, ...]
) -> tuple[Index, tuple[str, ...]]:
    """The rows that were not excluded and have a plausible size, and what was left out."""
    rows = kept_rows(table, (*request.exclude, *emptied))
    refuse_dead_axis(table, rows)
    refuse_units(table, rows)
    bad = implausible_rows(table, rows, refuse=not request.auto_exclude)
    said = [f"row {r}: excluded as asked" for r in request.exclude]
    said += [f"row {r}: left without a value by --shift" for r in emptied]
    said += [f"row {table.row[k]}: excluded automatically ({why})" for k, why in bad.items()]
    return np.setdiff1d(rows, list(bad)), tuple(said)


def _fit_and_look_for_slips(
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
            where = error.where or table.path
            raise type(error)(error.what, where=where, remedy=error.remedy) from error
        raise UnreadableInput(
            "; ".join(f.what for f in faults.slips),
            where=error.where,
            remedy=" ".join(f.line for f in faults.slips),
        ) from error
    slips = (*faults.slips, *(result.loop.slips if result.loop else ()))
    return result, replace(faults, slips=slips).with_axes(request)


def _questions(
    result: LabResult, faults: Faults, raw: RawUnit, request: LabRequest
) -> tuple[Question, ...]:
    """What only the user can decide: slips and wrong records, else doubts; a fleet's too."""
    found = faults.undecided(_records(result))
    for r in _records(result):
        what = (
            f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others "
            f"predict ({r.likely}, {per_cent(r.probability)})"
        )
        found += (settle(what, r, raw),)
    found += undecided_parts(result)
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


def _sensor(table: PositionTable, raw: RawUnit) -> Identity:
    """Whose readings a table has: of a recording's rests as the recording says."""
    own = table.sensor
    return own if own.unit else replace(own, unit=raw.name, to_m_per_s2=(raw.si,))


def lab_calibration(
    outcome: Outcome,
    result: LabResult,
    raw: RawUnit,
    details: Mapping[str, Any],
) -> Calibration:
    """The calibration of a run's final fit, with the blocks that people read beside the numbers."""
    facts = {
        "gravity_source": result.request.gravity_source,
        "errors": [error.as_dict() for error in outcome.errors],
        "noise": details["noise"],
        "held_out": details["held_out"],
    }
    if "fixture" in details:
        facts["conventions"] = asdict(result.request.conventions)
        facts["fixture"] = details["fixture"]
    if "between_sessions" in details:
        facts["between_sessions"] = details["between_sessions"]
    facts["left_out"] = details["left_out"]
    facts["undecided"] = list(map(str, outcome.undecided))
    facts["provenance"] = outcome.provenance.as_dict()
    return from_fit(
        result.final,
        "lab",
        raw_unit=raw.name,
        raw_to_si=raw.si,
        gravity=result.request.gravity,
        status=outcome.status,
        reasons=(*outcome.reasons, *map(str, outcome.undecided)),
        facts=facts,
        sensor=outcome.sensor,
    )


def lab_details(
    result: LabResult,
    excluded: tuple[str, ...],
    undecided: tuple[Question, ...],
    faults: Faults,
    sessions: Sessions | None,
) -> dict[str, Any]:
    """What only a bench has to say, for report.json; the shorter blocks also for the YAML."""
    details: dict[str, Any] = {
        "noise": noise_block(result.final),
        "held_out": _held_out_block(result),
        "left_out": list(excluded),
        "positions": _positions(result),
        "undecided": list(map(str, undecided)),
        "faults": [asdict(fault) for fault in faults.slips],
    }
    if isinstance(result.observations.reference, KnownVector):
        details["fixture"] = _fixture_block(result)
    if sessions:
        details["between_sessions"] = sessions.block()
    if result.loop is not None:
        fit = result.final
        # What neighbours share is noise of a later rest too.
        reading = reading_noise(fit).whole
        found = ambiguities(result.loop.final, result.loop.alternatives)
        details[KEY] = recorded_block(fit, found, reading=reading, settings=setting_noise(fit))
    return details


def noise_block(fit: Fit) -> dict[str, Any]:
    """Noise of the readings (mg) and scatter of the settings (deg), with their sd."""
    noise = reading_noise(fit)
    block: dict[str, Any] = {"reading_mg": noise.own / MG, "reading_sd_mg": noise.own_sd / MG}
    for k, (name, sd) in enumerate(setting_noise(fit).items(), start=1):
        key = name.replace(" ", "_").replace("-", "_")
        block[f"{key}_deg"] = sd / DEG
        block[f"{key}_sd_deg"] = sd / DEG * float(fit.noise_sd[k])
    if noise.shared > 0.0:
        block |= {"shared_mg": noise.shared / MG, "shared_sd_mg": noise.shared_sd / MG}
        block["shared_memory_positions"] = noise.memory
    return block


def _held_out_block(result: LabResult) -> list[dict[str, Any]]:
    """Errors on data that was not fitted, largest and rms, per split and model."""
    rows = []
    for split in result.splits:
        for name, held in (("base", split.base), ("final", split.final)):
            found = attitude_errors(held, result.request.conventions)
            row: dict[str, Any] = {"split": split.name, "model": name, "positions": len(split.rows)}
            if isinstance(result.observations.reference, KnownVector):
                row |= {
                    "tool_face_deg": [worst(found.tool_face), rms(found.tool_face)],
                    "inclination_deg": [worst(found.inclination), rms(found.inclination)],
                }
            rows.append({**row, "norm_mg": [worst(found.norm), rms(found.norm)]})
    return rows


def _fixture_block(result: LabResult) -> dict[str, Any]:
    """What the bench is off by: inclination against the dial with 95 % intervals."""
    fit = result.final
    effects = [e.name for e in fit.model.effects if e.stage == "fixture"]
    at = np.array([0.0, 30.0, 50.0, 60.0, 90.0])
    dial = dial_of(result, at)
    curve = [
        {
            "inclination_deg": float(a),
            "true_minus_dial_deg": float(s),
            "sd_deg": float(d),
            "low_95_deg": float(s - h),
            "high_95_deg": float(s + h),
        }
        for a, s, d, h in zip(at, dial.shift, dial.sd, dial.half, strict=True)
    ]
    return {"effects": effects, "inclination": curve if effects else []}


def _positions(result: LabResult) -> list[dict[str, Any]]:
    fit, whole = result.final, result.observations
    known = isinstance(whole.reference, KnownVector)
    held = errors(fit, fit.theta, whole)
    angle = attitude_errors(held, result.request.conventions)
    used = set(result.used.tolist())
    rows = []
    for k, label in enumerate(whole.label):
        row: dict[str, Any] = {
            "position": label,
            "fitted": k in used,
            "corrected_m_per_s2": held.corrected[k, 0].tolist(),
            "norm_error_mg": float(angle.norm[k]),
        }
        if known:
            row |= {
                "error_mg": (held.error[k, 0] / MG).tolist(),
                "inclination_error_deg": float(angle.inclination[k]),
                "tool_face_error_deg": float(angle.tool_face[k]),
            }
        rows.append(row)
    return rows
