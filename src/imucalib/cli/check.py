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
from imucalib.cli.output import color, emit_json, note, width, working

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.calibration.checking.check import Check, Measured
    from imucalib.calibration.checking.e_value import PastCheck
    from imucalib.calibration.checking.misfit import CheckNoise


def noise_of(calibration: Calibration, options: dict[str, Any]) -> CheckNoise:
    """What the options and the calibration say of the noise."""
    from imucalib.calibration.checking.limits import sessions_of, size_of
    from imucalib.calibration.checking.misfit import check_noise
    from imucalib.units import MG

    reading = options["noise"] and MG * size_of(options["noise"], {"mg": "force"})[0]
    session = sessions_of(options["between_sessions"])
    return check_noise(calibration, reading=reading, session=session)


def measured_of(
    calibration: Calibration,
    log: Path,
    noise: CheckNoise,
    options: dict[str, Any],
    past: tuple[PastCheck, ...],
) -> tuple[list[Measured], tuple[str, ...]]:
    """The log as misfits, sensor by sensor."""
    from dataclasses import replace

    from imucalib.calibration.checking.e_value import counted_once
    from imucalib.calibrators.check_log import Asked, array_log, sensor_log
    from imucalib.calibrators.lab.files import LabFiles

    files = LabFiles(log, None, pairs(options["columns"], "--columns"), mapping_of(options))
    stated = options["gravity"] is not None or options["latitude"] is not None
    gravity = gravity_of(options)[0] if stated else calibration.gravity
    asked = Asked(
        gravity, still_of(options), options["unit"], one_scale(options["lsb"]), options["triad"]
    )
    make = array_log if calibration.triads else sensor_log
    measured, notes = make(replace(calibration, gravity=gravity), files, noise, asked)
    with_past = [
        replace(
            m,
            past=counted_once(
                [o.sensors[m.name] for o in past if m.name in o.sensors], m.misfits.value
            ),
        )
        for m in measured
    ]
    before = max((sum(m.name in one.sensors for one in past) for m in measured), default=0)
    if again := before - max((len(m.past) for m in with_past), default=0):
        checks = "a check" if again == 1 else f"{again} checks"
        notes = (*notes, f"{checks} of the history had readings that came again: counted once")
    return with_past, notes


def append(path: Path, past: tuple[PastCheck, ...], found: Check, content: dict[str, Any]) -> None:
    """One more line, with when it was written."""
    from datetime import UTC, datetime

    from imucalib.calibration.checking.check import look_of
    from imucalib.calibration.checking.e_value import PastCheck, append_check

    told = {k: content[k] for k in ("calibration_sha256", "log", "verdict", "p", "e_value")}
    told["time"] = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    sensors = {s.name: look_of(s.misfits, s.p) for s in found.sensors}
    append_check(path, past, PastCheck(sensors, told))


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
@click.option(
    "--history",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File of this calibration's checks: adds a line; the evidence is of all lines.",
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
      imucal check out/calibration.yaml log.mcap --history checks.jsonl
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.checking.check import checked
    from imucalib.calibration.checking.e_value import read_history
    from imucalib.calibration.checking.limits import limits_of
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file
    from imucalib.report.check import check_dict, check_document
    from imucalib.report.files import shown_dict
    from imucalib.report.render.text import render_text

    inputs = inputs_of(options, calibration, log)
    if options["html"] is not None:
        demand_output(options["html"], inputs, force=options["force"])
    if options["history"] is not None:
        demand_output(options["history"], inputs, force=True)
    if options["effects_file"] is not None:
        load_file(options["effects_file"])
    limits = limits_of(options["limits"])
    loaded = read(calibration)
    check(loaded, str(calibration))
    noise = noise_of(loaded, options)
    past = read_history(options["history"], loaded.sha256) if options["history"] else ()
    with working("checking", quiet=options["quiet"]):
        measured, notes = measured_of(loaded, log, noise, options, past)
        found = checked(loaded, measured, noise, limits, seed=options["seed"], notes=notes)
    content = check_dict(found, log.name, calibration.name, loaded.sha256)
    document = check_document(found, log, calibration, command_line())
    if options["history"] is not None:
        append(options["history"], past, found, content)
        note(f"wrote {options['history']}", options["quiet"])
    if options["html"] is not None:
        from imucalib.calibration.file import write_whole
        from imucalib.report.render.html import render_html

        write_whole(options["html"], render_html(document))
        note(f"wrote {options['html']}", options["quiet"])
    if options["as_json"]:
        emit_json({**content, **shown_dict(document)})
    elif not options["quiet"]:
        click.echo(render_text(document, width(), color=color(), full=options["full"]), nl=False)
    return found.exit_code
