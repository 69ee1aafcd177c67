"""imucal check: Say whether a calibration is still good, from a few rests or positions.

imucal validate: Check a calibration file.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import command_line
from imucalib.cli.frame.output import present, tell, working
from imucalib.data import Data

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.calibration.checking.check import Measured
    from imucalib.calibration.checking.noise import CheckNoise
    from imucalib.recording.mapping import FieldMapping


@opt.command_with_page("check")
@click.argument("calibration", type=opt.PATH)
@click.argument("log", type=opt.PATH)
@opt.many(
    "--limit limits",
    "SIZE",
    "Change that matters: 2mg of bias, 0.1deg of mounting, 0.5deg/s of a gyro's "
    "bias. Default: 5 sd of one corrected reading.",
)
@opt.option(
    "--noise",
    "Scatter of one rest or position, for example 0.5mg; default: as the calibration states it.",
    metavar="SIZE",
)
@opt.many(
    "--between-sessions",
    "SIZE",
    "Scatter between power-ups: 0.5mg of bias, 0.05deg of mounting; default: as a "
    "calibration of several sessions states it.",
)
@opt.many(
    "--columns",
    "ROLE=NAME,...",
    "Columns of a table by heading: inclination, tool_face, face, x, y, z.",
)
@opt.same_device
@opt.effects
@opt.path("--html", "Also write the report as a page.")
@opt.shortest_rest
@opt.gravity
@opt.recording
@opt.page_options
def command(calibration: Path, log: Path, **options: Any) -> int:
    """Say whether a calibration is still good, from a few rests or positions.

    LOG is a recording with rests, or a table of positions as `lab` reads it; four suffice. Known
    angles or faces also test directions. Exit 0 still good, 1 changed, 5 undecided: with the
    probability of each change, the size that would have been seen, and the rests to add.

    \b
    Examples:
      imucal check out/calibration.yaml four_rests.csv --limit 2mg
      imucal check out/calibration.yaml log.mcap --html check.html
    """
    from imucalib.calibration.checking.check import check
    from imucalib.calibration.checking.noise import check_noise, limits_of, sessions_of, size_of
    from imucalib.report.check import check_dict, compose_check_document
    from imucalib.report.files import page_dict
    from imucalib.units import MG

    opt.demand_outputs(options, [], calibration, log)
    limits = limits_of(options["limits"])
    loaded = opt.calibration_of(calibration, options)
    reading = options["noise"] and MG * size_of(options["noise"], ("mg",))[0]
    session = sessions_of(options["between_sessions"])
    noise = check_noise(loaded, reading=reading, session=session)
    with working("checking", quiet=options["quiet"]):
        measured, notes = opt.read_as_calibrated(
            loaded, options, lambda mapping: _measure(loaded, log, mapping, noise, options)
        )
        found = check(loaded, measured, noise, limits, notes=notes)
    content = check_dict(found, log.name, calibration.name, loaded.sha256)
    document = compose_check_document(found, log, calibration, command_line())
    present(document, {**content, **page_dict(document)}, options)
    return found.exit_code


def _measure(
    calibration: Calibration,
    log: Path,
    mapping: FieldMapping,
    noise: CheckNoise,
    options: dict[str, Any],
) -> tuple[list[Measured], tuple[str, ...]]:
    """The log as misfits, sensor by sensor, and notes."""
    from dataclasses import replace

    from imucalib.calibrators.checking.check_log import CheckRequest, array_log, sensor_log
    from imucalib.calibrators.lab.files import LabFiles

    files = LabFiles(log, None, opt.pairs(options["columns"], "--columns"), mapping)
    stated = options["gravity"] is not None or options["latitude"] is not None
    gravity = opt.gravity_of(options)[0] if stated else calibration.gravity
    request = CheckRequest(
        gravity,
        opt.still_of(options),
        options["unit"],
        opt.one_scale(options["lsb"]),
    )
    make = array_log if calibration.triads else sensor_log
    return make(replace(calibration, gravity=gravity), files, noise, request)


class Validated(Data, name="validate/1"):
    """A calibration file that is whole."""

    file: str
    valid: bool
    status: str
    parameters: int


@opt.command_with_page("validate")
@click.argument("file", type=opt.PATH)
@opt.json
@opt.quiet
def validate(file: Path, **options: Any) -> int:
    """Check that a calibration file is whole, known to this version, and can be applied.

    \b
    Example: imucal validate out/calibration.yaml
    """
    found = opt.calibration_of(file, options)
    count = len(found.parameters)
    what = f"valid {found.calibrator} calibration, status {found.status}"
    made = Validated(str(file), True, found.status, count)
    tell(made, options, f"{file}: {what}, {count} parameters")
    return 0
