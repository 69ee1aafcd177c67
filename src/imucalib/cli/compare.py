"""imucal compare: Compare calibrations: do they differ, what it means, how they drift."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import command_line
from imucalib.cli.frame.output import present


@opt.command_with_page("compare")
@click.argument("calibrations", type=opt.PATH, nargs=-1, required=True)
@opt.many(
    "--limit limits",
    "SIZE",
    "Difference that matters: 2mg of force, 0.1deg of direction, 0.2mm of position, "
    "0.5deg/s of a gyro's bias. Default: twice the largest stated sd.",
)
@opt.option(
    "--dates",
    "When each was recorded, for the drift; default: as the files say.",
    metavar="DATE,...",
)
@opt.many(
    "--between-sessions between",
    "SIZE",
    "Scatter between power-ups: 0.5mg of bias, 0.05deg of mounting; default: as "
    "calibrations of several sessions state it.",
)
@opt.path(
    "--effects effects_file", "Python file with effects of your own that the calibrations use."
)
@opt.path("--html", "Also write the report as a page, with its control chart.")
@opt.page_options
def command(calibrations: tuple[Path, ...], **options: Any) -> int:
    """Say whether calibrations of one sensor differ, what that means, and how they drift.

    Exit 0 they agree, 1 they differ beyond the limit, 5 the files are too uncertain to tell.

    \b
    Examples:
      imucal compare spring/calibration.yaml autumn/calibration.yaml --limit 2mg
      imucal compare 20*/calibration.yaml --html chart.html
    """
    from imucalib.calibration.checking.noise import limits_of, sessions_of
    from imucalib.calibration.comparison.compare import compare
    from imucalib.report.comparison import comparison_dict, compose_comparison_document
    from imucalib.report.files import page_dict

    opt.demand_outputs(options, [], *calibrations)
    wanted = limits_of(options["limits"])
    loaded = [opt.calibration_of(path, options) for path in calibrations]
    dated = options["dates"].split(",") if options["dates"] else ()
    sessions = sessions_of(options["between"])
    found = compare(loaded, _names(calibrations), wanted, dated, sessions)
    document = compose_comparison_document(found, calibrations, command_line())
    present(document, {**comparison_dict(found), **page_dict(document)}, options)
    return found.exit_code


def _names(paths: tuple[Path, ...]) -> list[str]:
    """What tells the files apart: their names, else their folders'."""
    names = [path.stem for path in paths]
    if len(set(names)) == len(names):
        return names
    folders = [path.absolute().parent.name for path in paths]
    if len(set(folders)) == len(folders):
        return folders
    return [f"{name} ({k})" for k, name in enumerate(folders, start=1)]
