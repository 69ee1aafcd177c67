"""From a position table to an outcome: checking what a user mistakes, calibrating, judging."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.outcome import Outcome, Run, list_open, provenance_of
from imucalib.calibrators.lab.advice import (
    advice,
    find_undecided,
    limits_of,
    reasons,
    settle,
)
from imucalib.calibrators.lab.bench import PreparedTable, RawUnit, prepare_table, row_numbers
from imucalib.calibrators.lab.calibrate import LabResult, calibrate
from imucalib.calibrators.lab.dial import dial_of
from imucalib.calibrators.lab.errors import (
    attitude_errors,
    reading_noise,
    rms,
    sessions_of,
    setting_noise,
    worst,
)
from imucalib.calibrators.lab.faults import Faults, list_doubts, look_for_faults, worthless
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.repairs import repair
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.next_recording import describe_recorded
from imucalib.calibrators.population import not_of_its_kind
from imucalib.calibrators.sessions import BetweenSessions
from imucalib.core.fit import Fit
from imucalib.core.references import KnownVector
from imucalib.data import Data, plain
from imucalib.errors import NotConverged, Undetermined, UnreadableInput, UsageError
from imucalib.posterior.closed_loop.separation import ambiguities
from imucalib.posterior.held_out import errors
from imucalib.posterior.record_errors import RecordError
from imucalib.posterior.sheet.sheet import Fault
from imucalib.question import Question
from imucalib.recording.identity import Identity
from imucalib.significant_digits import per_cent
from imucalib.units import DEG, MG


class HeldOutRow(Data, kw_only=True):
    """A model's errors on positions that it was not fitted to: largest and rms."""

    split: str
    model: str
    positions: int
    tool_face_deg: Annotated[tuple[float, float] | None, "Where angles are known."] = None
    inclination_deg: tuple[float, float] | None = None
    norm_mg: tuple[float, float]


class PositionFacts(Data):
    """A position, and the final model's errors at it."""

    position: str
    fitted: Annotated[bool, "Whether it took part in the fit."]
    corrected_m_per_s2: Array
    norm_error_mg: float
    error_mg: Annotated[Array | None, "Of the vector, where angles are known."] = None
    inclination_error_deg: float | None = None
    tool_face_error_deg: float | None = None


class DialAt(Data):
    """The true inclination beside the dial's."""

    inclination_deg: float
    true_minus_dial_deg: float
    sd_deg: float
    low_95_deg: float
    high_95_deg: float


class Fixture(Data):
    """What the bench is off by."""

    effects: tuple[str, ...]
    inclination: Annotated[tuple[DialAt, ...], "Empty without an effect of the bench."]


class LabDetails(Data, beside=("report", "calibrator", "lab")):
    """What only a bench has to say."""

    noise: Annotated[Mapping[str, float], "Of readings and settings, each with its sd."]
    held_out: tuple[HeldOutRow, ...]
    left_out: Annotated[tuple[str, ...], "Rows, and why."]
    positions: tuple[PositionFacts, ...]
    undecided: tuple[str, ...]
    faults: Annotated[tuple[Fault, ...], "Slips of hand."]
    fixture: Annotated[Fixture | None, "Where angles are known."] = None
    between_sessions: Annotated[BetweenSessions | None, "Of several power-ups."] = None
    record_next: Annotated[Mapping[str, Any] | None, "For `imucal design --separate`."] = None


@dataclass(frozen=True, kw_only=True)
class LabRun(Run):
    """A finished run: what all calibrators share, and what only the report of `lab` shows.

    recorded : the readings are a recording's rests, and no table's
    """

    details: LabDetails
    result: LabResult
    table: PositionTable
    raw: RawUnit
    request: LabRequest
    faults: Faults
    recorded: bool = False


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
    prepared = prepare_table(table, request, emptied)
    if mapping is not None:
        sentence = "m/s², as the recording was read"
        prepared = replace(prepared, raw=replace(prepared.raw, sentence=sentence))
    prepared, result, faults = _fit_right_rows(prepared, request)
    table, raw = prepared.table, prepared.raw
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
            settings={**request.describe_settings(), "unit": raw.name},
            seed=request.seed,
            command=request.command,
        ),
        findings=request.findings(result.loop),
        fit=result.final,
        reasons=reasons(result) + worthless(result, prepared.whole),
        advice=advice(result, raw),
        undecided=undecided,
        limits=limits_of(result, request.limits),
        notes=(raw.sentence, *table.left_out, *faults.notes, *notes),
        left=list_open(result.loop, result.error),
        sensor=_sensor(table, raw),
    )
    sessions = sessions_of(result.final, table.sessions)
    details = lab_details(result, prepared.excluded, undecided, faults, sessions)
    return LabRun(
        outcome=outcome,
        calibration=lab_calibration(outcome, result, raw, details),
        details=details,
        result=result,
        table=table,
        raw=raw,
        request=request,
        faults=faults,
        recorded=mapping is not None,
    )


def _fit_right_rows(
    prepared: PreparedTable, request: LabRequest
) -> tuple[PreparedTable, LabResult, Faults]:
    """The calibration and its slips, with `auto_exclude` without the rows that it shows wrong."""
    result, faults = _fit_and_look_for_slips(prepared, request, first=True)
    bad = _wrong_rows(result, faults, prepared) if request.auto_exclude else {}
    if bad:
        excluded = (*prepared.excluded, *bad.values())
        rows = np.setdiff1d(prepared.rows, list(bad))
        prepared = replace(prepared, rows=rows, excluded=excluded)
        result, faults = _fit_and_look_for_slips(prepared, request, first=False)
    return prepared, result, faults


def _fit_and_look_for_slips(
    prepared: PreparedTable, request: LabRequest, *, first: bool
) -> tuple[LabResult, Faults]:
    """The calibration of the sheet as it is, and its slips of hand; at first without a search where
    a whole column is in the wrong place, which physics would explain. What cannot be fitted at all
    ends with what to paste."""
    faults, kept = look_for_faults(prepared, request), prepared.whole.take(prepared.rows)
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
            where = error.where or prepared.table.path
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
    found = faults.list_questions(_records(result))
    for r in _records(result):
        what = (
            f"{r.where}: {r.channel} is {r.size:.3g} ± {r.sd:.2g} {r.unit} off what the others "
            f"predict ({r.likely}, {per_cent(r.probability)})"
        )
        found += (settle(what, r, raw),)
    found += find_undecided(result)
    instead = "calibrate it alone, in 24 positions or more, without --fleet"
    return (found or list_doubts(result, raw, request)) + not_of_its_kind(
        result.kind_chance, instead
    )


def _wrong_rows(result: LabResult, faults: Faults, prepared: PreparedTable) -> dict[int, str]:
    """Rows (from 0) that are wrong one by one, by the search or as slips of hand, and why."""
    by_search = {
        int(prepared.rows[result.used[r.row]]): f"{r.where}: excluded automatically "
        f"({r.channel} off by {r.size:.3g} {r.unit}, {r.likely})"
        for r in _records(result)
    }
    by_hand = {
        prepared.table.at(f.rows[0]): f"{f.what}; excluded automatically"
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
    details: LabDetails,
) -> Calibration:
    """The calibration of a run's final fit, with the blocks that people read beside the numbers."""
    facts = {
        "gravity_source": result.request.gravity_source,
        "errors": [error.as_dict() for error in outcome.errors],
        "noise": details.noise,
        "held_out": plain(details.held_out),
    }
    if details.fixture:
        facts["conventions"] = asdict(result.request.conventions)
        facts["fixture"] = details.fixture.as_dict()
    if details.between_sessions:
        facts["between_sessions"] = details.between_sessions.as_dict()
    facts["left_out"] = list(details.left_out)
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
    sessions: BetweenSessions | None,
) -> LabDetails:
    """What only a bench has to say."""
    fit, recorded = result.final, None
    if result.loop is not None:
        # What neighbours share is noise of a later rest too.
        reading = reading_noise(fit).whole
        found = ambiguities(result.loop.final, result.loop.alternatives)
        recorded = describe_recorded(fit, found, reading=reading, settings=setting_noise(fit))
    known = isinstance(result.observations.reference, KnownVector)
    return LabDetails(
        noise=noise_block(fit),
        held_out=_describe_held_out(result),
        left_out=excluded,
        positions=_positions(result),
        undecided=tuple(map(str, undecided)),
        faults=faults.slips,
        fixture=_fixture(result) if known else None,
        between_sessions=sessions,
        record_next=recorded,
    )


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


def _describe_held_out(result: LabResult) -> tuple[HeldOutRow, ...]:
    """Errors on data that was not fitted, per split and model."""
    known, rows = isinstance(result.observations.reference, KnownVector), []
    for split in result.splits:
        for name, held in (("base", split.base), ("final", split.final)):
            found = attitude_errors(held, result.request.conventions)
            angles = {"tool_face_deg": found.tool_face, "inclination_deg": found.inclination}
            sizes = {"norm_mg": found.norm} | (angles if known else {})
            both = {key: (worst(off), rms(off)) for key, off in sizes.items()}
            count = len(split.rows)
            rows.append(HeldOutRow(split=split.name, model=name, positions=count, **both))
    return tuple(rows)


def _fixture(result: LabResult) -> Fixture:
    """What the bench is off by: inclination against the dial with 95 % intervals."""
    effects = tuple(e.name for e in result.final.model.effects if e.stage == "fixture")
    at = np.array([0.0, 30.0, 50.0, 60.0, 90.0])
    dial = dial_of(result, at)
    ends = dial.shift - dial.half, dial.shift + dial.half
    curve = np.stack([at, dial.shift, dial.sd, *ends], axis=1).tolist() if effects else []
    return Fixture(effects, tuple(DialAt(*row) for row in curve))


def _positions(result: LabResult) -> tuple[PositionFacts, ...]:
    fit, whole = result.final, result.observations
    known = isinstance(whole.reference, KnownVector)
    held = errors(fit, fit.theta, whole)
    angle = attitude_errors(held, result.request.conventions)
    used = set(result.used.tolist())
    return tuple(
        PositionFacts(
            position=label,
            fitted=k in used,
            corrected_m_per_s2=held.corrected[k, 0],
            norm_error_mg=float(angle.norm[k]),
            error_mg=held.error[k, 0] / MG if known else None,
            inclination_error_deg=float(angle.inclination[k]) if known else None,
            tool_face_error_deg=float(angle.tool_face[k]) if known else None,
        )
        for k, label in enumerate(whole.label)
    )
