"""From files to a lab run: a position table, a recording with its positions, or still segments; and
what a table holds, before anything is calibrated."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np

from imucalib.calibrators.lab.bench import prepare_table
from imucalib.calibrators.lab.faults import look_for_faults
from imucalib.calibrators.lab.headings import roles_of
from imucalib.calibrators.lab.position_table import (
    ANGLES,
    PositionTable,
    cells_of_positions,
    read_position_table,
)
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.core.angle_conventions import Conventions
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.question import Question
from imucalib.readers import read
from imucalib.readers.csv.table import Cells
from imucalib.readers.csv.text import take_turns
from imucalib.readers.fields.words import triples_of
from imucalib.recording.identity import identity_of, same_parameters
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.recording.sensors import accelerometer
from imucalib.rests.candidates import refusals
from imucalib.rests.segments import Segments, still_segments
from imucalib.rests.stillness import StillSettings
from imucalib.units import ACCELERATION_UNITS

#: What a mapping may state of a table; anything else is of a recording in time.
_OF_TABLES = {
    "sensor",
    "acc_unit",
    "lsb_per_g",
    "acc_offset",
    "skip",
    "decimal",
    "delimiter",
    "where",
}

Say = Callable[[str], None]


@dataclass(frozen=True)
class LabFiles:
    """Inputs of `lab`. table : or a recording at rest; others : more power-ups of the same sensor
    columns : role -> heading of the table; mapping : of the recording."""

    table: Path
    recording: Path | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    mapping: FieldMapping = field(default_factory=FieldMapping)
    others: tuple[Path, ...] = ()


def calibrate_files(files: LabFiles, request: LabRequest, say: Say) -> LabRun:
    """Read, check and calibrate. `say` gets one line for each thing worth knowing on the way."""
    if files.recording is not None:
        if files.others:
            raise UsageError(
                "--recording goes with one table",
                remedy="give each power-up a table with its readings, and no --recording",
            )
        positions = _table(files, request, need_raw=False)
        recording, segments = still_rests(files.recording, files.mapping, request.still, say)
        return run_of_rests([_in_order(positions, segments, recording)], [recording], request, say)
    paths = (files.table, *files.others)
    if request.reference == "norm" and positions_in(files) is None:
        read_ = [still_rests(path, files.mapping, request.still, say) for path in paths]
        tables = [table_of_rests(segments, recording) for recording, segments in read_]
        return run_of_rests(tables, [recording for recording, _ in read_], request, say)
    each = [_order_rows(replace(files, table=path), request, say) for path in paths]
    table, joining = _join_sessions(each, say)
    return run_lab(table, request, notes=joining)


def run_of_rests(
    tables: Sequence[PositionTable],
    recordings: Sequence[Recording],
    request: LabRequest,
    say: Say,
) -> LabRun:
    """Calibrate rests of recordings, each a power-up of the same sensor. Errors as in `run_lab`."""
    table, joining = _join_sessions(tables, say)
    notes = dict.fromkeys(note for recording in recordings for note in recording.notes)
    return run_lab(
        table,
        replace(request, unit=None, lsb_per_g=None),  # of the recording, and applied already
        mapping=recordings[0].mapping,
        gaps=sum(len(recording.gaps) for recording in recordings),
        notes=(*notes, *joining),
    )


def _order_rows(files: LabFiles, request: LabRequest, say: Say) -> PositionTable:
    as_written = _table(files, request)
    table = as_written.by_time
    if not np.array_equal(table.row, as_written.row):
        say("rows are taken in the order of their time, not of the file")
    say("; ".join((f"read {table.n} positions from {files.table}", *table.left_out)))
    return table


def _table(files: LabFiles, request: LabRequest, *, need_raw: bool = True) -> PositionTable:
    zero = request.conventions.inclination_zero
    try:
        table = read_position_table(
            files.table,
            files.columns,
            need_raw=need_raw,
            need_angles=request.reference == "vector",
            need_direction=request.reference == "direction",
            mapping=files.mapping if need_raw else None,
            exclude=request.exclude,
            zero=zero,
        )
    except UsageError as error:
        error.add += _settle_further(files, request, error.add)
        raise
    if need_raw:
        table = table.once
        if request.unit is None and request.lsb_per_g is None:
            table = _of_one_unit(table)
        table = _from_zero(table, files.mapping)
    stated = table.inclination_zero
    if request.reference == "vector" and stated and stated != zero:
        raise UsageError(
            f"the heading '{table.names['inclination']}' counts inclination from the {stated}, and "
            f"the run from the {zero}",
            where=str(files.table),
            remedy=f"add --inclination-zero {stated}, or correct the heading",
        )
    return table


def _settle_further(
    files: LabFiles, request: LabRequest, sensor: tuple[str, ...]
) -> tuple[str, ...]:
    """What the sensor that an error's words name needs as well, so that what is printed runs."""
    if not sensor:
        return ()
    named = replace(files, mapping=replace(files.mapping, sensor=sensor[-1]))
    try:
        wrong = _look_at_table(_table(named, request), request).wrong
    except ImucalError:  # which is said once the sensor is named
        return ()
    return next((one.options for one in wrong if one.options), ())


def _of_one_unit(table: PositionTable) -> PositionTable:
    """The table with x, y and z in the unit of x. Raises UnreadableInput where they do not say."""
    stated = [table.unit.get(axis, "") for axis in "xyz"]
    if len(set(stated)) == 1:
        return table
    if not all(unit in ACCELERATION_UNITS for unit in stated):
        said = ", ".join(f"{a} {u or 'nothing'}" for a, u in zip("xyz", stated, strict=True))
        raise UnreadableInput(
            f"the headings state different units ({said}), which do not go together",
            where=table.path,
            remedy="give each axis its unit, or name one for all with --unit",
        )
    columns = dict(table.columns)
    for axis, unit in zip("xyz", stated, strict=True):
        columns[axis] = columns[axis] * (ACCELERATION_UNITS[unit] / ACCELERATION_UNITS[stated[0]])
    return replace(table, columns=columns, unit={**table.unit, **dict.fromkeys("xyz", stated[0])})


def _from_zero(table: PositionTable, mapping: FieldMapping) -> PositionTable:
    """The table's readings without what they show at zero g, one number or one an axis."""
    zero = mapping.acc_offset
    if not zero:
        return table
    if len(zero) not in (1, 3):
        raise UsageError("--acc-offset needs one value, or one an axis", where=table.path)
    less = dict(zip("xyz", np.broadcast_to(zero, 3), strict=True))
    columns = {k: v - less.get(k, 0.0) for k, v in table.columns.items()}
    return replace(table, columns=columns, sensor=replace(table.sensor, zero=zero))


def positions_in(files: LabFiles, cells: Cells | None = None) -> PositionTable | None:
    """The table of positions that a file is, or None where it is a recording in time.

    cells : of the table, where they were read already
    """
    if not files.mapping.to_dict().keys() <= _OF_TABLES:
        return None
    try:
        cells = cells or cells_of_positions(files.table, files.mapping)
    except ImucalError:
        return None
    if cells is None:
        return None
    for direction in (True, False):
        try:
            table = read_position_table(
                files.table,
                files.columns,
                need_angles=False,
                need_direction=direction,
                mapping=files.mapping,
                cells=cells,
            )
        except ImucalError:
            continue
        if table.of_positions or set(table.columns) >= ANGLES or direction:
            return table
    return None


def still_rests(
    path: Path, mapping: FieldMapping, still: StillSettings, say: Say
) -> tuple[Recording, Segments]:
    """A recording of one sensor and its rests; raises UsageError where it is of several, else as
    `rests_of`."""
    recording = read(path, mapping)
    accelerometer(recording)
    return recording, rests_of(recording, still, say)


def rests_of(recording: Recording, still: StillSettings, say: Say) -> Segments:
    """The rests of a recording; raises UnreadableInput where it has none."""
    path = recording.path
    segments = still_segments(recording, still)
    span = max((float(c.t[-1]) for c in recording.channels.values() if c.t.size), default=0.0)
    say(f"read {path} ({recording.format}, {span:.0f} s): {segments.n} still segments")
    for text in (*recording.notes, *segments.notes):
        say(f"  {text}")
    if segments.n == 0:
        raise UnreadableInput(
            f"no rest in it: {refusals(segments.candidates)}",
            where=path,
            remedy=f"hold each position still for {still.shortest:g} s or more "
            "(--shortest-rest); `imucal inspect FILE --rests` lists what was refused",
        )
    return segments


def table_of_rests(segments: Segments, recording: Recording) -> PositionTable:
    """Still segments of a sensor as a table in m/s². Every rest weighs the same: between
    rests a sensor scatters more than averaging suggests."""
    columns = dict(zip("xyz", segments.mean[:, 0].T, strict=True))
    columns["time"] = 0.5 * (segments.start + segments.stop)
    warm = segments.temperature[:, 0]
    if np.isfinite(warm).all():
        columns["temperature"] = warm
    return PositionTable(
        columns,
        {k: k for k in columns},
        dict.fromkeys("xyz", "m/s2"),
        np.arange(1, segments.n + 1),
        recording.path,
        recording.sha256,
        sensor=identity_of(recording, segments.triads[0], segments.step[0]),
    )


def _in_order(positions: PositionTable, segments: Segments, recording: Recording) -> PositionTable:
    """The positions' angles with the rests' readings, matched by their order."""
    if positions.n != segments.n:
        spans = zip(segments.start, segments.stop, strict=True)
        raise UsageError(
            f"the table has {positions.n} positions, the recording {segments.n} rests "
            f"(at s: {', '.join(f'{a:.1f}-{b:.1f}' for a, b in spans)})",
            where=recording.path,
            remedy="add or remove rows so that they match one to one, in order",
        )
    rests = table_of_rests(segments, recording)
    columns = {**rests.columns, **{k: v for k, v in positions.columns.items() if k not in "xyz"}}
    names = {**rests.names, **positions.names}
    return replace(rests, columns=columns, names=names, unit={**rests.unit, **positions.unit})


def _join_sessions(
    tables: Sequence[PositionTable], say: Say
) -> tuple[PositionTable, tuple[str, ...]]:
    """Tables of one sensor, one a power-up, as one table with a column session whose rows count
    through all, and notes on what was left out or renumbered, which are said.

    Columns that one of them lacks are left out. Raises UsageError for units that differ, for a
    column session beside several files, and for a file that is given twice.
    """
    first, *others = tables
    if not others:
        return first, ()
    _demand_one_sensor(tables)
    roles = [role for role in first.columns if all(role in one for one in others)]
    columns = {role: np.concatenate([one.columns[role] for one in tables]) for role in roles}
    columns["session"] = np.repeat(np.arange(len(tables)), [one.n for one in tables]).astype(float)
    names = tuple(Path(one.path).stem for one in tables)
    whole = replace(
        first,
        columns=columns,
        names={role: name for role, name in first.names.items() if role in roles},
        row=np.arange(1, len(columns["session"]) + 1),
        path=", ".join(Path(one.path).name for one in tables),
        sha256=hashlib.sha256("".join(one.sha256 for one in tables).encode()).hexdigest(),
        sessions=names if len(set(names)) == len(names) else tuple(one.path for one in tables),
        files=tuple(one.sha256 for one in tables),
    )
    last = np.cumsum([one.n for one in tables])
    spans = (
        f"{Path(one.path).name} {end - one.n + 1}-{end}"
        for one, end in zip(tables, last, strict=True)
    )
    notes = [f"rows count through all files: {', '.join(spans)}"]
    if lost := sorted({role for one in tables for role in one.columns} - set(roles)):
        notes.append(f"left out, since not every file has it: {', '.join(lost)}")
    for note in notes:
        say(note)
    return whole, tuple(notes)


def _demand_one_sensor(tables: Sequence[PositionTable]) -> None:
    first = tables[0]
    for k, one in enumerate(tables):
        if one.sessions:
            raise UsageError(
                "a column session beside several files",
                where=one.path,
                remedy="give one file with the column, or files without it: each is a session",
            )
        if one.unit != first.unit or one.inclination_zero != first.inclination_zero:
            raise UsageError(
                f"its units {one.unit or 'are not stated'}, those of {first.path} "
                f"{first.unit or 'are not stated'}",
                where=one.path,
                remedy="use the same headings in all files of one sensor",
            )
        if not same_parameters(one.sensor, first.sensor):
            raise UsageError(
                f"the controller's parameters are others than in {first.path}",
                where=one.path,
                remedy="calibrate logs with the same parameters together",
            )
        twin = next((o for o in tables[:k] if o.sha256 == one.sha256), None)
        if twin is not None:
            raise UsageError(
                f"the same readings as {twin.path}",
                where=one.path,
                remedy="give each power-up once",
            )


@dataclass(frozen=True)
class TableSeen:
    """A table and how `lab` would read it.

    kind : the reference that its columns give; a plan has angles alone; unit : of the readings, and
    how it is known; wrong : what is to be settled
    """

    table: PositionTable
    kind: str
    unit: str
    wrong: tuple[Question, ...] = ()
    notes: tuple[str, ...] = ()


def inspect_table(path: Path, mapping: FieldMapping) -> TableSeen | None:
    """A table of positions as it would be read, or None where a file is none. Raises
    UnreadableInput where headings say that it is one and its cells cannot be read."""
    try:
        cells = cells_of_positions(path, mapping)
        if cells is None:
            return None
        roles = set(roles_of(list(cells.columns), {}, str(path)))
    except ImucalError:
        return None
    if roles >= ANGLES:
        # Of which sensor, is asked where there are several.
        raw = set("xyz") <= roles or bool(triples_of(list(cells.columns)))
        table = read_position_table(path, need_raw=raw, mapping=mapping, cells=cells)
        if not raw:
            return TableSeen(table, "plan", "", (), table.left_out)
        table = _from_zero(table, mapping)
        return _look_at_table(table, _request_for(table, "vector", mapping))
    devices = any(take_turns(n, [str(c) for c in own]) for n, own in cells.columns.items())
    found = None if devices else positions_in(LabFiles(path, mapping=mapping), cells)
    if found is None or not ("ux" in found or found.turns):
        return None
    kind = "direction" if "ux" in found else "norm"
    found = _from_zero(found, mapping)
    return _look_at_table(found, _request_for(found, kind, mapping))


def _request_for(table: PositionTable, kind: str, mapping: FieldMapping) -> LabRequest:
    """The request of a command that states no more than the file and how it is read."""
    zero: Literal["vertical", "horizontal"] = (
        "vertical" if table.inclination_zero == "vertical" else "horizontal"
    )
    lsb = mapping.lsb_per_g
    return LabRequest(
        reference=kind,
        unit=mapping.acc_unit or None,
        lsb_per_g=float(lsb[0]) if lsb else None,
        conventions=Conventions(inclination_zero=zero),
    )


def _look_at_table(table: PositionTable, request: LabRequest) -> TableSeen:
    notes, wrong, unit = table.left_out, list[Question](), ""
    try:
        prepared = prepare_table(table, request)
        unit = prepared.raw.sentence
        faults = look_for_faults(prepared, request).with_axes(request)
        notes = (*prepared.table.left_out, *faults.notes)
        wrong += faults.list_questions(())
    except ImucalError as error:
        where = error.where.removeprefix(table.path).lstrip(", ")
        what = f"{where}: {error.what}" if where else error.what
        wrong.append(Question(what, error.add, error.remedy))
    return TableSeen(table, request.reference, unit, tuple(wrong), notes)
