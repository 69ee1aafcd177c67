"""imucal check"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.calibrating import command_line
from imucalib.cli.options import (
    PagedCommand,
    force_option,
    full_option,
    gravity_of,
    gravity_options,
    inputs_of,
    json_option,
    mapping_of,
    one_scale,
    pairs,
    quiet_option,
    recording_options,
    seed_option,
    shortest_rest_option,
    still_of,
)
from imucalib.cli.output import present, working

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.calibration.checking.check import Measured
    from imucalib.calibration.checking.noise import CheckNoise


def noise_of(calibration: Calibration, options: dict[str, Any]) -> CheckNoise:
    """What the options and the calibration say of the noise."""
    from imucalib.calibration.checking.noise import check_noise, sessions_of, size_of
    from imucalib.units import MG

    reading = options["noise"] and MG * size_of(options["noise"], ("mg",))[0]
    session = sessions_of(options["between_sessions"])
    return check_noise(calibration, reading=reading, session=session)


def measured_of(
    calibration: Calibration,
    log: Path,
    noise: CheckNoise,
    options: dict[str, Any],
) -> tuple[list[Measured], tuple[str, ...]]:
    """The log as misfits, sensor by sensor."""
    from dataclasses import replace

    from imucalib.calibrators.check_log import CheckRequest, array_log, sensor_log
    from imucalib.calibrators.lab.files import LabFiles

    files = LabFiles(log, None, pairs(options["columns"], "--columns"), mapping_of(options))
    stated = options["gravity"] is not None or options["latitude"] is not None
    gravity = gravity_of(options)[0] if stated else calibration.gravity
    request = CheckRequest(
        gravity, still_of(options), options["unit"], one_scale(options["lsb"]), options["triad"]
    )
    make = array_log if calibration.triads else sensor_log
    return make(replace(calibration, gravity=gravity), files, noise, request)


@click.command("check", cls=PagedCommand, short_help="Is a calibration still good?")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="SIZE",
    help="Change that matters: 2mg of bias, 0.1deg of mounting, 0.5deg/s of a gyro's "
    "bias. Default: 5 sd of one corrected reading.",
)
@click.option(
    "--noise",
    metavar="SIZE",
    help="Scatter of one rest or position, for example 0.5mg; "
    "default: as the calibration states it.",
)
@click.option(
    "--between-sessions",
    multiple=True,
    metavar="SIZE",
    help="Scatter between power-ups: 0.5mg of bias, 0.05deg of mounting; default: as a "
    "calibration of several sessions states it.",
)
@click.option("--triad", help="Which sensor, when the log has several.")
@click.option(
    "--columns",
    multiple=True,
    metavar="ROLE=NAME,...",
    help="Columns of a table by heading: inclination, tool_face, face, x, y, z.",
)
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own that the calibration uses.",
)
@click.option("--html", type=click.Path(path_type=Path), help="Also write the report as a page.")
@shortest_rest_option
@gravity_options
@force_option
@recording_options
@seed_option
@full_option
@json_option
@quiet_option
def command(calibration: Path, log: Path, **options: Any) -> int:
    """Say whether a calibration is still good, from a few rests or positions.

    LOG is a recording with rests, or a table of positions as `lab` reads it; four suffice. Known
    angles or faces also test directions. Exit 0 still good, 1 changed, 5 undecided: with the change
    that could have been seen, and the rests to add.

    \b
    Examples:
      imucal check out/calibration.yaml four_rests.csv --limit 2mg
      imucal check out/calibration.yaml log.mcap --html check.html
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.checking.check import checked
    from imucalib.calibration.checking.noise import limits_of
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file
    from imucalib.report.check import check_dict, check_document
    from imucalib.report.files import shown_dict

    inputs = inputs_of(options, calibration, log)
    if options["html"] is not None:
        demand_output(options["html"], inputs, force=options["force"])
    if options["effects_file"] is not None:
        load_file(options["effects_file"])
    limits = limits_of(options["limits"])
    loaded = read(calibration)
    check(loaded, str(calibration))
    noise = noise_of(loaded, options)
    with working("checking", quiet=options["quiet"]):
        measured, notes = measured_of(loaded, log, noise, options)
        found = checked(loaded, measured, noise, limits, seed=options["seed"], notes=notes)
    content = check_dict(found, log.name, calibration.name, loaded.sha256)
    document = check_document(found, log, calibration, command_line())
    present(document, {**content, **shown_dict(document)}, options, options["html"])
    return found.exit_code
