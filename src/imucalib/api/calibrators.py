"""The calibrators as functions: a file in, a `Result` out.

Usual choices are keywords. All others are fields of the calibrator's request, which is given as
`request`; the keywords that are given replace its fields. Failures are the exceptions of
`imucalib.errors`, with the exit code that the command would end with.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from imucalib.api.result import Result
from imucalib.calibration.calibration import Calibration
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.array.board import Board, read_board
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.calibrators.imu.calibrate import ImuRequest
from imucalib.calibrators.lab.request import LabRequest
from imucalib.readers import read as read_recording
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from imucalib.units import STANDARD_GRAVITY

Say = Callable[[str], None]
Place = Path | str


def _silent(_: str) -> None:
    """What a calibrator says on its way goes nowhere unless it is asked for."""


def _gravity(given: float | None) -> dict[str, Any]:
    """Fields of a request that a stated gravity replaces."""
    return {} if given is None else {"gravity": given, "gravity_source": "as given"}


def _search(declare: Sequence[str] | None, loop: bool | None) -> dict[str, Any]:
    """Fields of a request that choices of the search replace."""
    declared = {} if declare is None else {"declare": tuple(declare)}
    return {**declared, **({} if loop is None else {"loop": loop})}


def read(path: Place, mapping: FieldMapping | None = None) -> Recording:
    """A recording of any format, in SI units. Raises UnreadableInput."""
    return read_recording(Path(path), mapping)


def load(path: Place) -> Calibration:
    """A calibration.yaml, checked. Raises UnreadableInput."""
    from imucalib.calibration.file import check
    from imucalib.calibration.file import read as read_calibration

    found = read_calibration(Path(path))
    check(found, str(path))
    return found


def lab(
    table: Place | Sequence[Place],
    *,
    recording: Place | None = None,
    gravity: float | None = None,
    reference: str | None = None,
    fix: Sequence[tuple[int, str, float]] | None = None,
    exclude: Sequence[int] | None = None,
    declare: Sequence[str] | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: LabRequest | None = None,
    say: Say = _silent,
) -> Result:
    """Calibrate a tool's accelerometer on a bench, or at rest by gravity alone.

    table : positions with angles and readings, or angles alone with a `recording` of the rests;
        several are power-ups of one sensor
    gravity : local, m/s²; reference : "vector", "direction" or "norm"
    fix : (row from 1, column, value) of cells to repair; exclude : rows from 1 to leave out
    declare : effects of the base model; loop : whether to search for what it lacks
    mapping : how the recording is read; say : gets a line for each thing worth knowing
    """
    from imucalib.calibrators.lab.files import LabFiles, calibrate_files
    from imucalib.report.lab import lab_document

    asked = request or LabRequest()
    settings = asked.settings
    asked = replace(asked, settings=replace(settings, **_search(declare, loop)))
    asked = replace(asked, **_gravity(gravity))
    if reference is not None:
        asked = replace(asked, reference=reference)
    if fix is not None:
        asked = replace(asked, fixes=tuple(fix))
    if exclude is not None:
        asked = replace(asked, exclude=tuple(exclude))
    asked = replace(asked, seed=asked.seed if seed is None else seed)
    first, *others = (table,) if isinstance(table, str | Path) else table
    files = LabFiles(
        Path(first),
        None if recording is None else Path(recording),
        mapping=mapping or FieldMapping(),
        others=tuple(map(Path, others)),
    )
    run = calibrate_files(files, asked, say)
    return Result(run, lab_document(run))


def actigraph(
    recording: Place,
    *,
    gravity: float | None = None,
    declare: Sequence[str] | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: ActigraphRequest | None = None,
    say: Say = _silent,
) -> Result:
    """Calibrate a worn accelerometer from days of recording, by gravity in every posture at rest.

    gravity : local, m/s², by default the standard's; others as in `lab`
    """
    from imucalib.calibrators.actigraph.run import calibrate_recording
    from imucalib.report.actigraph import actigraph_document

    asked = request or ActigraphRequest()
    asked = replace(asked, **_gravity(gravity))
    asked = replace(asked, **_search(declare, loop))
    asked = replace(asked, seed=asked.seed if seed is None else seed)
    run = calibrate_recording(Path(recording), mapping or FieldMapping(), asked, say)
    return Result(run, actigraph_document(run))


def array(
    log: Place | Recording,
    board: Place | Board,
    *,
    gravity: float | None = None,
    samples: int | None = None,
    loop: bool | None = None,
    seed: int | None = None,
    mapping: FieldMapping | None = None,
    request: ArrayRequest | None = None,
    say: Say = _silent,
) -> Result:
    """Find the positions of the accelerometers of an inertial sensor array.

    log : a recording or its path; board : a drawing, its file, or the name of one that ships
    samples : moving samples that are used, at most; others as in `lab`
    """
    from imucalib.calibrators.array.calibrate import calibrate_array
    from imucalib.report.array import array_document

    drawn = board if isinstance(board, Board) else read_board(str(board))
    asked = replace(request, board=drawn) if request else ArrayRequest(drawn, STANDARD_GRAVITY)
    asked = replace(asked, **_gravity(gravity))
    if samples is not None:
        asked = replace(asked, samples=samples)
    asked = replace(asked, **_search(None, loop))
    asked = replace(asked, seed=asked.seed if seed is None else seed)
    found = log if isinstance(log, Recording) else read(log, mapping)
    run = calibrate_array(found, asked, say)
    return Result(run, array_document(run))


def imu(
    recording: Place | Sequence[Place],
    *,
    gravity: float | None = None,
    declare: Sequence[str] | None = None,
    loop: bool | None = None,
    mapping: FieldMapping | None = None,
    request: ImuRequest | None = None,
    say: Say = _silent,
) -> Result:
    """Calibrate accelerometer and gyroscope of one IMU from rests and the turns between them.

    recording : a log, or several of one IMU; gravity : local, m/s², by default the standard's;
    others as in `lab`
    """
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.report.imu import imu_document

    asked = request or ImuRequest()
    asked = replace(asked, **_gravity(gravity))
    asked = replace(asked, **_search(declare, loop))
    paths = (recording,) if isinstance(recording, str | Path) else recording
    run = run_imu(tuple(map(Path, paths)), mapping or FieldMapping(), asked, say)
    return Result(run, imu_document(run))
