"""The calibrators as functions: a file, a table or an array in, a `Result` out.

Usual choices are keywords by the names of the command's options. All others are fields of the
calibrator's request, which is given as `request`; the keywords that are given replace its fields.
Failures are the exceptions of `imucalib.errors`, with the exit code that the command would end
with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from imucalib.api.given import RECORDING, TABLE, Reading, as_file, gravity_of, mapping_of
from imucalib.api.result import Result
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.array.board import Board, read_board
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.lab.request import LabRequest
from imucalib.readers import read as read_recording
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.units import STANDARD_GRAVITY

Say = Callable[[str], None]
Place = Path | str
#: A file, or what a notebook holds: a DataFrame, columns by name, or an array (see `api.given`).
Given = Place | Mapping[str, Any] | Any


def _silent(_: str) -> None:
    """What a calibrator says on its way goes nowhere unless it is asked for."""


def _each(given: Given) -> tuple[Given, tuple[Path, ...]]:
    """What is given, or the first of several files, and the others."""
    if isinstance(given, list | tuple) and all(isinstance(one, str | Path) for one in given):
        return given[0], tuple(map(Path, given[1:]))
    return given, ()


def _search(
    declare: Sequence[str] | None,
    loop: bool | None,
    only: Sequence[str] | None = None,
    without: Sequence[str] | None = None,
) -> dict[str, Any]:
    """Fields of a request that choices of the search replace."""
    named = {"declare": declare, "only": only, "without": without}
    given = {name: tuple(value) for name, value in named.items() if value is not None}
    return {**given, **({} if loop is None else {"loop": loop})}


def read(path: Given, mapping: FieldMapping | None = None, **reading: Unpack[Reading]) -> Recording:
    """A recording of any format, or of a DataFrame or array, in SI units. Raises UnreadableInput.

    reading : options of the command, such as acc="X,Y,Z", unit="g", rate=100
    """
    with as_file(path, RECORDING) as file:
        return read_recording(file, mapping_of(mapping, reading))


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
    gravity: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    reference: str | None = None,
    convention: str | None = None,
    columns: Mapping[str, str] | None = None,
    fix: Sequence[tuple[int, str, float]] | None = None,
    exclude: Sequence[int] | None = None,
    swap_angles: bool | None = None,
    declare: Sequence[str] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: LabRequest | None = None,
    say: Say = _silent,
    **reading: Unpack[Reading],
) -> Result:
    """Calibrate a tool's accelerometer on a bench, or at rest by gravity alone.

    table : positions with angles and readings, or angles alone with a `recording` of the rests, as
        a file, a DataFrame, or an array (n, 3) of x, y, z or (n, 5) with inclination and tool-face
        before them; several files are power-ups of one sensor
    gravity : local, m/s², or latitude (deg) and height (m); reference : "vector", "direction" or
        "norm"; convention : of the angles, a name of the command's; columns : role -> heading
    fix : (row from 1, column, value) of cells to repair; exclude : rows from 1 to leave out
    declare : effects of the base model; loop : whether to search for what it lacks; only, without :
        what is searched for
    mapping, reading : how the file is read; say : gets a line for each thing worth knowing
    """
    from imucalib.calibrators.lab.conventions import preset
    from imucalib.calibrators.lab.files import LabFiles, calibrate_files
    from imucalib.report.lab import lab_document

    asked = request or LabRequest()
    read_as = mapping_of(mapping, reading)
    stated = {
        "reference": reference,
        "conventions": None if convention is None else preset(convention),
        "fixes": None if fix is None else tuple(fix),
        "exclude": None if exclude is None else tuple(exclude),
        "swap_angles": swap_angles,
        "seed": seed,
        "unit": reading.get("unit"),
        "lsb_per_g": reading.get("lsb"),
        **gravity_of(gravity, latitude, height),
        **_search(declare, loop, only, without),
    }
    given = {name: value for name, value in stated.items() if value is not None}
    asked = replace(asked, **given)
    first, others = _each(table)
    with as_file(first, TABLE) as file:
        files = LabFiles(
            file,
            None if recording is None else Path(recording),
            columns=columns or {},
            mapping=read_as,
            others=others,
        )
        run = calibrate_files(files, asked, say)
    return Result(run, lab_document(run))


def actigraph(
    recording: Given,
    *,
    gravity: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    declare: Sequence[str] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: ActigraphRequest | None = None,
    say: Say = _silent,
    **reading: Unpack[Reading],
) -> Result:
    """Calibrate a worn accelerometer from days of recording, by gravity in every posture at rest.

    recording : a file, a DataFrame, or an array (n, 4) of time (s), x, y, z, or (n, 3) with `rate`
    gravity : local, m/s², by default the standard's; others as in `lab`
    """
    from imucalib.calibrators.actigraph.run import calibrate_recording
    from imucalib.report.actigraph import actigraph_document

    asked = request or ActigraphRequest()
    asked = replace(asked, **gravity_of(gravity, latitude, height))
    asked = replace(asked, **_search(declare, loop, only, without))
    asked = replace(asked, seed=asked.seed if seed is None else seed)
    with as_file(recording, RECORDING) as file:
        run = calibrate_recording(file, mapping_of(mapping, reading), asked, say)
    return Result(run, actigraph_document(run))


def array(
    log: Given | Recording,
    board: Place | Board,
    *,
    gravity: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    samples: int | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: ArrayRequest | None = None,
    say: Say = _silent,
    **reading: Unpack[Reading],
) -> Result:
    """Find the positions of the accelerometers of an inertial sensor array.

    log : a recording or its path; board : a drawing, its file, or the name of one that ships
    samples : moving samples that are used, at most; others as in `lab`
    """
    from imucalib.calibrators.array.calibrate import calibrate_array
    from imucalib.report.array import array_document

    drawn = board if isinstance(board, Board) else read_board(str(board))
    asked = replace(request, board=drawn) if request else ArrayRequest(drawn, STANDARD_GRAVITY)
    asked = replace(asked, **gravity_of(gravity, latitude, height))
    if samples is not None:
        asked = replace(asked, samples=samples)
    asked = replace(asked, **_search(None, loop))
    asked = replace(asked, seed=asked.seed if seed is None else seed)
    found = log if isinstance(log, Recording) else read(log, mapping, **reading)
    run = calibrate_array(found, asked, say)
    return Result(run, array_document(run))


def imu(
    recording: Given | Sequence[Place],
    *,
    gravity: float | None = None,
    latitude: float | None = None,
    height: float = 0.0,
    declare: Sequence[str] | None = None,
    only: Sequence[str] | None = None,
    without: Sequence[str] | None = None,
    loop: bool | None = None,
    mapping: FieldMapping | None = None,
    request: ImuRequest | None = None,
    say: Say = _silent,
    **reading: Unpack[Reading],
) -> Result:
    """Calibrate accelerometer and gyroscope of one IMU from rests and the turns between them.

    recording : a log, or several of one IMU; a DataFrame, or an array (n, 7) of time (s),
        acceleration and rate, or (n, 6) with `rate`; gravity : local, m/s²; others as in `lab`
    """
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.report.imu import imu_document

    asked = request or ImuRequest()
    asked = replace(asked, **gravity_of(gravity, latitude, height))
    asked = replace(asked, **_search(declare, loop, only, without))
    first, others = _each(recording)
    with as_file(first, RECORDING) as file:
        run = run_imu((file, *others), mapping_of(mapping, reading), asked, say)
    return Result(run, imu_document(run))
