"""From files to a lab run: a position table, a recording with its positions, or still segments."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.calibrators.lab.position_table import PositionTable, read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.calibrators.lab.sessions.joined_tables import joined
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.readers import read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.rests.candidates import refusals
from imucalib.rests.segments import Segments, still_segments
from imucalib.rests.stillness import StillSettings
from imucalib.units import ACCELERATION_UNITS

ANGLES = {"inclination", "tool_face"}
#: Inclinations at which the tool-face is none, deg.
_VERTICAL = {"horizontal": (90.0, -90.0), "vertical": (0.0, 180.0)}


@dataclass(frozen=True)
class LabFiles:
    """Inputs of `lab`. table : or a recording at rest; others : more power-ups of the same sensor
    columns : role -> heading of the table; mapping : of the recording."""

    table: Path
    recording: Path | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    mapping: FieldMapping = field(default_factory=FieldMapping)
    others: tuple[Path, ...] = ()

    @property
    def each(self) -> tuple[LabFiles, ...]:
        """Every power-up by itself."""
        return tuple(replace(self, table=t, others=()) for t in (self.table, *self.others))


def calibrate_files(files: LabFiles, request: LabRequest, say: Callable[[str], None]) -> LabRun:
    """Read, check and calibrate. `say` gets one line for each thing worth knowing on the way."""
    if files.others:
        return _sessions(files, request, say)
    if files.recording is not None:
        positions = _table(files, request, need_raw=False)
        recording, segments = still_rests(files.recording, files.mapping, request.still, say)
        table = _in_order(positions, segments, recording)
        return _run(table, recording, request)
    if request.reference == "norm" and positions_in(files) is None:
        recording, segments = still_rests(files.table, files.mapping, request.still, say)
        return _run(table_of_rests(segments, recording), recording, request)
    return run_lab(_ordered(files, request, say), request)


def _sessions(files: LabFiles, request: LabRequest, say: Callable[[str], None]) -> LabRun:
    """Several power-ups of one sensor, of tables or all of recordings at rest."""
    if files.recording is not None:
        raise UsageError(
            "--recording goes with one table",
            remedy="give each power-up a table with its readings, and no --recording",
        )
    of_rests = request.reference == "norm" and positions_in(files) is None
    tables, notes = list[PositionTable](), list[str]()
    for one in files.each:
        if not of_rests:
            tables.append(_ordered(one, request, say))
            continue
        recording, segments = still_rests(one.table, one.mapping, request.still, say)
        tables.append(table_of_rests(segments, recording))
        notes += recording.notes
    table, joining = joined(tables)
    for note in joining:
        say(note)
    if of_rests:
        request = replace(request, unit=None, lsb_per_g=None)
    return run_lab(table, request, notes=(*notes, *joining))


def _ordered(files: LabFiles, request: LabRequest, say: Callable[[str], None]) -> PositionTable:
    read = _table(files, request)
    table = read.by_time
    if not np.array_equal(table.row, read.row):
        say("rows are taken in the order of their time, not of the file")
    say("; ".join((f"read {table.n} positions from {files.table}", *table.left_out)))
    return table


def _table(files: LabFiles, request: LabRequest, *, need_raw: bool = True) -> PositionTable:
    table = read_position_table(
        files.table,
        files.columns,
        need_raw=need_raw,
        need_angles=request.reference == "vector",
        need_direction=request.reference == "direction",
        mapping=files.mapping if files.recording is None else None,
        exclude=request.exclude,
        vertical=_VERTICAL[request.settings.conventions.inclination_zero],
    )
    table = table.once if need_raw else table
    if need_raw and request.unit is None and request.lsb_per_g is None:
        table = _of_one_unit(table)
    if need_raw and files.mapping.acc_offset:
        table = _counted_from(files.mapping.acc_offset, table)
    stated, zero = table.inclination_zero, request.settings.conventions.inclination_zero
    if request.reference == "vector" and stated and stated != zero:
        raise UsageError(
            f"the heading '{table.names['inclination']}' counts inclination from the {stated}, and "
            f"the run from the {zero}",
            where=str(files.table),
            remedy=f"add --inclination-zero {stated}, or correct the heading",
        )
    return table


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


def _counted_from(zero: tuple[float, ...], table: PositionTable) -> PositionTable:
    """The table's readings without what they show at zero g, one number or one an axis."""
    if len(zero) not in (1, 3):
        raise UsageError("--acc-offset needs one value, or one an axis", where=table.path)
    less = dict(zip("xyz", np.broadcast_to(zero, 3), strict=True))
    return replace(table, columns={k: v - less.get(k, 0.0) for k, v in table.columns.items()})


def positions_in(files: LabFiles) -> PositionTable | None:
    """The table of positions that a file is, or None where it is a recording in time."""
    of_both = {"acc_unit", "lsb_per_g", "acc_offset", "skip", "decimal", "delimiter", "where"}
    if not files.mapping.to_dict().keys() <= of_both:
        return None
    for direction in (True, False):
        try:
            table = read_position_table(
                files.table,
                files.columns,
                need_angles=False,
                need_direction=direction,
                mapping=files.mapping,
            )
        except ImucalError:
            continue
        if table.of_positions or set(table.columns) >= ANGLES or direction:
            return table
    return None


def still_rests(
    path: Path, mapping: FieldMapping, still: StillSettings, say: Callable[[str], None]
) -> tuple[Recording, Segments]:
    """A recording and its rests; raises UnreadableInput where it has none."""
    recording = read(path, mapping)
    segments = still_segments(recording, still)
    span = max((float(c.t[-1]) for c in recording.channels.values() if c.t.size), default=0.0)
    say(f"read {path} ({recording.format}, {span:.0f} s): {segments.n} still segments")
    for text in (*recording.notes, *segments.notes):
        say(f"  {text}")
    if segments.n == 0:
        raise UnreadableInput(
            f"no rest in it: {refusals(segments.candidates)}",
            where=str(path),
            remedy=f"hold each position still for {still.shortest:g} s or more "
            "(--shortest-rest); `imucal inspect FILE --rests` lists what was refused",
        )
    return recording, segments


def table_of_rests(segments: Segments, recording: Recording) -> PositionTable:
    """Still segments of the first triad as a table in m/s²."""
    mean = segments.mean[:, 0]
    columns = {"x": mean[:, 0], "y": mean[:, 1], "z": mean[:, 2]}
    columns["time"] = 0.5 * (segments.start + segments.stop)
    warm = segments.temperature[:, 0]
    if np.isfinite(warm).all():
        columns["temperature"] = warm
    unit = dict.fromkeys("xyz", "m/s2")
    # Every rest weighs the same: between rests a sensor scatters more than averaging suggests.
    return PositionTable(
        columns,
        {k: k for k in columns},
        unit,
        np.arange(1, segments.n + 1),
        recording.path,
        recording.sha256,
    )


def _in_order(positions: PositionTable, segments: Segments, recording: Recording) -> PositionTable:
    """The positions' angles with the rests' readings, matched by their order."""
    if positions.n != segments.n:
        ends = ", ".join(
            f"{a:.1f}-{b:.1f}" for a, b in zip(segments.start, segments.stop, strict=True)
        )
        raise UsageError(
            f"the table has {positions.n} positions, the recording {segments.n} rests "
            f"(at s: {ends})",
            where=recording.path,
            remedy="add or remove rows so that they match one to one, in order",
        )
    rests = table_of_rests(segments, recording)
    columns = {**rests.columns, **{k: v for k, v in positions.columns.items() if k not in "xyz"}}
    names = {**rests.names, **positions.names}
    return replace(rests, columns=columns, names=names, unit={**rests.unit, **positions.unit})


def _run(table: PositionTable, recording: Recording, request: LabRequest) -> LabRun:
    # The unit that was stated is the recording's, and has been applied.
    request = replace(request, unit=None, lsb_per_g=None)
    return run_lab(
        table, request, mapping=recording.mapping, gaps=len(recording.gaps), notes=recording.notes
    )
