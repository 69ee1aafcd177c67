"""imucal fleet: Calibrate devices of one kind together."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import command_line
from imucalib.cli.frame.output import Say, note, present, working
from imucalib.question import paste

if TYPE_CHECKING:
    from imucalib.cohort.fleet.outcome import Fleet
    from imucalib.report.render.document import Document

#: What holds for all inputs; other options are read with tables.
_OF_ALL = "inputs output only without devices full force as_json verbose quiet"


@opt.command_with_page("fleet")
@click.argument("inputs", metavar="INPUT...", nargs=-1, required=True, type=opt.PATH)
@opt.folder(
    "-o --output", "Folder for report.html, report.json and each device's calibration.yaml."
)
@opt.choice("--reference", "vector direction norm", "As of imucal lab.", default="vector")
@opt.many("--columns", "ROLE=NAME,...", "Columns by heading.")
@opt.option("--exclude", "Rows to leave out of every table.", default="", metavar="ROWS")
@opt.only
@opt.without
@opt.file(
    "--devices",
    "Of calibrations: CSV that says which recording is of which device, columns "
    "recording and device; default: by serial number, else one each.",
)
@opt.full
@opt.gravity
@opt.recording
@opt.shortest_rest
@opt.force
@opt.json
@opt.verbose
@opt.quiet
def command(inputs: tuple[Path, ...], **options: Any) -> int:
    """Calibrate devices of one kind together: effects too small for one device, found in all.

    Each INPUT is one device's table, as imucal lab reads it; or calibrations, of worn sensors or
    arrays: folders that imucal actigraph or array wrote, or the entries of imucal batch. An effect
    exists in all devices or in none, and each has its own size, for which the others are a prior.
    Exit 5 where something stays open: a suspicion, a device that is not of the kind, an input that
    could not be used.

    \b
    Examples:
      imucal fleet sample_logs/cave_*.csv --reference norm -o fleet
      imucal fleet entries --devices cohort.csv -o fleet
    """
    from imucalib.report.files import page_dict
    from imucalib.report.fleet import compose_fleet_document, fleet_dict

    folder, quiet = options["output"], options["quiet"]
    if folder is not None and not options["force"]:
        _demand(folder)
    with working("calibrating", quiet=quiet, verbose=options["verbose"]) as say:
        fleet = _fleet(inputs, options, say)
    document = compose_fleet_document(fleet)
    if folder is None:
        document = document.propose_writing(f"{fleet.command} -o fleet")
    else:
        document = document.place_commands({"folder": paste(folder)})
    content = {"schema": "imucal/fleet/1", **fleet_dict(fleet), **page_dict(document)}
    if folder is not None:
        _write(fleet, document, content, folder, quiet)
    present(document, content, options)
    return fleet.exit_code


def _fleet(inputs: tuple[Path, ...], options: dict[str, Any], say: Say) -> Fleet:
    """Of tables, or of calibrations; raises UsageError where they are mixed."""
    from imucalib.calibrators.lab.files import LabFiles
    from imucalib.calibrators.lab.request import LabRequest
    from imucalib.cohort.fleet.recorded import Wanted, is_calibrated, run_recorded
    from imucalib.cohort.fleet.run import run_fleet
    from imucalib.errors import UsageError

    devices = options["devices"]
    made = [path for path in inputs if is_calibrated(path)]
    if made and len(made) < len(inputs):
        raise UsageError(
            f"{made[0]} is a calibration, {next(p for p in inputs if p not in made)} a table",
            remedy="give one or the other",
        )
    if made:
        _demand_usable()
        wanted = Wanted(options["only"], options["without"], devices, command_line())
        return run_recorded(made, wanted, say)
    if devices is not None:
        raise UsageError("--devices is for calibrations", remedy="each table is a device")
    columns, mapping = opt.pairs(options["columns"], "--columns"), opt.mapping_of(options)
    files = [LabFiles(table, None, columns, mapping) for table in inputs]
    gravity, source = opt.gravity_of(options)
    request = LabRequest(
        **{name: options[name] for name in ("unit", "reference", "only", "without")},
        lsb_per_g=opt.one_scale(options["lsb"]),
        gravity=gravity,
        gravity_source=source,
        exclude=opt.row_numbers(options["exclude"], "--exclude"),
        still=opt.still_of(options),
        command=command_line(),
    )
    return run_fleet(files, request, say)


def _demand_usable() -> None:
    """Refuse what says how to read a table, beside calibrations."""
    from click.core import ParameterSource

    from imucalib.errors import UsageError

    context = click.get_current_context()
    for parameter in context.command.params:
        name = str(parameter.name)
        stated = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if stated and name not in _OF_ALL.split():
            raise UsageError(
                f"{parameter.opts[0]} says how to read a table, and calibrations were given",
                remedy="leave it out",
            )


def _demand(folder: Path) -> None:
    """Refuse a folder that holds something before the work is done."""
    from imucalib.errors import UsageError

    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError(
            "it is not empty", where=str(folder), remedy="name another folder, or give --force"
        )


def _write(
    fleet: Fleet, document: Document, content: Mapping[str, Any], folder: Path, quiet: bool
) -> None:
    from imucalib.calibration.file import to_yaml, write_together
    from imucalib.calibrators.population import to_yaml as to_text
    from imucalib.data import json_text
    from imucalib.report.render.html import render_html

    made = {
        folder / m.folder_of(r) / "calibration.yaml": to_yaml(r.calibration)
        for m in fleet.members
        for r in m.recordings
    }
    texts = {
        folder / "report.html": render_html(document),
        folder / "report.json": json_text(content) + "\n",
        **({folder / "fleet.yaml": to_text(fleet.following)} if fleet.following else {}),
        **made,
    }
    write_together(texts)
    next_ = f"imucal {fleet.calibrator} --fleet"
    more = f", fleet.yaml for the next device ({next_})" if fleet.following else ""
    note(f"wrote {folder}: report.html, report.json, {len(made)} calibrations{more}", quiet)
