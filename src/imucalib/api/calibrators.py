"""The calibrators as functions: a file, a table or an array in, a `Result` out.

Usual choices (`Usual`, of a bench `Bench`) are keywords by the names of the command's options. All
others are fields of the calibrator's request, which is given as `request`; the keywords that are
given replace its fields. Failures are the exceptions of `imucalib.errors`, with the exit code that
the command would end with.
"""

from __future__ import annotations

import csv
import difflib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypedDict, TypeVar, Unpack

import numpy as np

from imucalib.api.result import Result
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.array.board.board import Board, read_board
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.lab.request import LabRequest
from imucalib.errors import UsageError
from imucalib.readers import read as read_recording
from imucalib.recording.mapping import OPTION_FIELDS, FieldMapping, from_dict
from imucalib.recording.recording import Recording
from imucalib.units import resolve_gravity

Say = Callable[[str], None]
AnyRequest = TypeVar("AnyRequest", LabRequest, ActigraphRequest, ImuRequest, ArrayRequest)
Place = Path | str
#: A file, or what a notebook holds: a DataFrame, columns by name, or an array (see `read`).
Given = Place | Mapping[str, Any] | Any


#: Headings of an array's columns, by their number: of positions, and of a recording in time.
_TABLE = {3: ("x", "y", "z"), 5: ("inclination", "tool_face", "x", "y", "z")}
_ACC, _GYRO = ("acc_x", "acc_y", "acc_z"), ("gyr_x", "gyr_y", "gyr_z")
_RECORDING = {
    3: _ACC,
    4: ("time (s)", *_ACC),
    6: (*_ACC, *_GYRO),
    7: ("time (s)", *_ACC, *_GYRO),
}


class Reading(TypedDict, total=False):
    """How a recording or table is read, by the names of the command's options."""

    sensor: str
    acc: str
    gyro: str
    temperature: str
    time: str
    unit: str
    gyro_unit: str
    temperature_unit: str
    time_unit: str
    time_format: str
    lsb: float
    gyro_lsb: float
    rate: float
    axis_map: str
    preset: str
    acc_offset: str
    skip: int
    decimal: str
    delimiter: str


class Usual(Reading, total=False):
    """What every calibrator can be asked for, and how the file is read.

    gravity : local, m/s², by default the standard's; or latitude (deg) and height (m)
    declare : effects of the base model; only, without : what is searched for
    loop : whether to search for what the base model lacks; seed : of all randomness
    mapping : how the file is read, under what single options of `Reading` say
    say : gets a line for each thing worth knowing
    """

    gravity: float | None
    latitude: float | None
    height: float
    declare: Sequence[str] | None
    only: Sequence[str] | None
    without: Sequence[str] | None
    loop: bool | None
    seed: int | None
    mapping: FieldMapping | None
    say: Say


class Bench(Usual, total=False):
    """What a bench can be asked for beside that.

    reference : "vector", "direction" or "norm"; convention : of the angles, by a name of the
        command's; columns : role -> heading
    fix : (row from 1, column, value) of cells to repair; exclude : rows from 1 to leave out
    swap_angles : whether the angle columns are exchanged
    """

    reference: str | None
    convention: str | None
    columns: Mapping[str, str] | None
    fix: Sequence[tuple[int, str, float]] | None
    exclude: Sequence[int] | None
    swap_angles: bool | None


def _silent(_: str) -> None:
    """What a calibrator says on its way goes nowhere unless it is asked for."""


def _each(given: Given) -> tuple[Given, tuple[Path, ...]]:
    """What is given, or the first of several files, and the others."""
    if isinstance(given, list | tuple) and all(isinstance(one, str | Path) for one in given):
        return given[0], tuple(map(Path, given[1:]))
    return given, ()


def _apply_options(
    request: AnyRequest, options: Mapping[str, Any], kind: type = Usual, **stated: Any
) -> tuple[AnyRequest, FieldMapping, Say]:
    """The request with what is stated, and not None, in place of its fields; how the file is read;
    and who hears of the work.

    options : keywords of a calibrator, those that `kind` names; stated : fields by their own names
    Raises UsageError for an option that there is not.
    """
    _demand_known(options, kind)
    stated |= {one.name: options.get(one.name) for one in fields(request) if one.name in options}
    place = (options.get("gravity"), options.get("latitude"), options.get("height", 0.0))
    stated["gravity"], stated["gravity_source"] = resolve_gravity(*place) or (None, None)
    given: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list | range) else value
        for name, value in stated.items()
        if value is not None
    }
    reading = {name: options[name] for name in Reading.__annotations__ if name in options}
    mapping = _mapping_of(options.get("mapping"), reading)
    return replace(request, **given), mapping, options.get("say", _silent)


def read(path: Given, mapping: FieldMapping | None = None, **reading: Unpack[Reading]) -> Recording:
    """A recording of any format, or of a DataFrame or array, in SI units. Raises UnreadableInput.

    reading : options of the command, such as acc="X,Y,Z", unit="g", rate=100
    """
    _demand_known(reading, Reading)
    with _as_file(path, _RECORDING) as file:
        return read_recording(file, _mapping_of(mapping, reading))


def load(path: Place) -> Calibration:
    """A calibration.yaml, checked. Raises UnreadableInput."""
    from imucalib.calibration.file import check
    from imucalib.calibration.file import read as read_calibration

    found = read_calibration(Path(path))
    check(found, str(path))
    return found


def lab(
    table: Given | Sequence[Place],
    *,
    recording: Place | None = None,
    request: LabRequest | None = None,
    **options: Unpack[Bench],
) -> Result:
    """Calibrate a tool's accelerometer on a bench, or at rest by gravity alone.

    table : positions with angles and readings, or angles alone with a `recording` of the rests, as
        a file, a DataFrame, or an array (n, 3) of x, y, z or (n, 5) with inclination and tool-face
        before them; several files are power-ups of one sensor
    """
    from imucalib.calibrators.lab.files import LabFiles, calibrate_files
    from imucalib.core.angle_conventions import preset
    from imucalib.report.lab import compose_lab_document

    named = options.get("convention")
    wanted, mapping, say = _apply_options(
        request or LabRequest(),
        options,
        Bench,
        conventions=None if named is None else preset(named),
        fixes=options.get("fix"),
        lsb_per_g=options.get("lsb"),
    )
    first, others = _each(table)
    log = None if recording is None else Path(recording)
    with _as_file(first, _TABLE) as file:
        files = LabFiles(file, log, options.get("columns") or {}, mapping, others=others)
        run = calibrate_files(files, wanted, say)
    return Result(run, compose_lab_document(run))


def actigraph(
    recording: Given, *, request: ActigraphRequest | None = None, **options: Unpack[Usual]
) -> Result:
    """Calibrate a worn accelerometer from days of recording, by gravity in every posture at rest.

    recording : a file, a DataFrame, or an array (n, 4) of time (s), x, y, z, or (n, 3) with `rate`
    """
    from imucalib.calibrators.actigraph.run import calibrate_recording
    from imucalib.report.actigraph import compose_actigraph_document

    wanted, mapping, say = _apply_options(request or ActigraphRequest(), options)
    with _as_file(recording, _RECORDING) as file:
        run = calibrate_recording(file, mapping, wanted, say)
    return Result(run, compose_actigraph_document(run))


def array(
    log: Given | Recording,
    board: Place | Board,
    *,
    samples: int | None = None,
    request: ArrayRequest | None = None,
    **options: Unpack[Usual],
) -> Result:
    """Find the positions of the accelerometers of an inertial sensor array.

    log : a recording or its path; board : a drawing, its file, or the name of one that ships
    samples : moving samples that are used, at most
    """
    from imucalib.calibrators.array.calibrate import calibrate_array
    from imucalib.report.array import compose_array_document

    drawn = board if isinstance(board, Board) else read_board(str(board))
    asked = request or ArrayRequest(board=drawn)
    wanted, mapping, say = _apply_options(asked, options, board=drawn, samples=samples)
    run = calibrate_array(log if isinstance(log, Recording) else read(log, mapping), wanted, say)
    return Result(run, compose_array_document(run))


def imu(
    recording: Given | Sequence[Place],
    *,
    request: ImuRequest | None = None,
    **options: Unpack[Usual],
) -> Result:
    """Calibrate accelerometer and gyroscope of one IMU from rests and the turns between them.

    recording : a log, or several of one IMU; a DataFrame, or an array (n, 7) of time (s),
        acceleration and rate, or (n, 6) with `rate`
    """
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.report.imu import compose_imu_document

    wanted, mapping, say = _apply_options(request or ImuRequest(), options)
    first, others = _each(recording)
    with _as_file(first, _RECORDING) as file:
        run = run_imu((file, *others), mapping, wanted, say)
    return Result(run, compose_imu_document(run))


def _demand_known(options: Mapping[str, Any], kind: type) -> None:
    """Raise UsageError for an option that a kind of options does not name."""
    known = kind.__annotations__
    for name in options:
        if name not in known:
            close = difflib.get_close_matches(name, known, 1)
            remedy = f"did you mean {close[0]}" if close else f"there are: {', '.join(known)}"
            raise UsageError(f"no option '{name}'", remedy=remedy)


def _mapping_of(base: FieldMapping | None, reading: Mapping[str, Any]) -> FieldMapping:
    """A mapping with single options over it."""
    stated = {OPTION_FIELDS.get(name, name): value for name, value in reading.items()}
    return from_dict(stated, "keywords").fill_from(base or FieldMapping())


@contextmanager
def _as_file(data: Any, headings: Mapping[int, tuple[str, ...]]) -> Iterator[Path]:
    """The path of a file, or of a file that holds a table for as long as it is read: a DataFrame,
    columns by name, or an array (n, k) whose k columns are `headings[k]`. Raises UsageError."""
    if isinstance(data, str | Path):
        yield Path(data)
        return
    columns = _columns(data, headings)
    with TemporaryDirectory(prefix="imucal-") as folder:
        path = Path(folder) / "given.csv"
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(columns)
            writer.writerows(zip(*columns.values(), strict=True))
        yield path


def _columns(data: Any, headings: Mapping[int, tuple[str, ...]]) -> dict[str, list[Any]]:
    """Name -> cells as text that reads back to the same number."""
    if isinstance(data, Mapping) or hasattr(data, "columns"):
        names = list(data) if isinstance(data, Mapping) else list(data.columns)
        return {str(name): _cells(np.asarray(data[name])) for name in names}
    values = np.asarray(data, np.float64)
    if values.ndim != 2 or values.shape[1] not in headings:
        allowed = "; ".join(f"{k}: {', '.join(names)}" for k, names in headings.items())
        raise UsageError(
            f"an array of shape {values.shape} has no known columns",
            remedy=f"give a DataFrame, or an array with columns of {allowed}",
        )
    return {n: _cells(c) for n, c in zip(headings[values.shape[1]], values.T, strict=True)}


def _cells(values: Any) -> list[Any]:
    if values.dtype.kind == "M":
        return list(np.datetime_as_string(values))
    if values.dtype.kind == "f":
        return ["" if np.isnan(v) else repr(float(v)) for v in values]
    return [str(v) for v in values]
