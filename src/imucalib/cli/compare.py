"""imucal compare"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli.calibrating import command_line
from imucalib.cli.options import PagedCommand, force_option, full_option, json_option, quiet_option
from imucalib.cli.output import present


@click.command("compare", cls=PagedCommand, short_help="Compare calibrations of one sensor.")
@click.argument("calibrations", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--limit",
    "limits",
    multiple=True,
    metavar="SIZE",
    help="Difference that matters: 2mg of force, 0.1deg of direction, 0.2mm of position, "
    "0.5deg/s of a gyro's bias. Default: twice the largest stated sd.",
)
@click.option(
    "--dates",
    metavar="DATE,...",
    help="When each was recorded, for the drift; default: as the files say.",
)
@click.option(
    "--between-sessions",
    "between",
    multiple=True,
    metavar="SIZE",
    help="Scatter between power-ups: 0.5mg of bias, 0.05deg of mounting; default: as "
    "calibrations of several sessions state it.",
)
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own that the calibrations use.",
)
@click.option(
    "--html",
    type=click.Path(path_type=Path),
    help="Also write the report as a page, with its control chart.",
)
@force_option
@full_option
@json_option
@quiet_option
def command(
    calibrations: tuple[Path, ...],
    limits: tuple[str, ...],
    dates: str | None,
    between: tuple[str, ...],
    effects_file: Path | None,
    html: Path | None,
    **options: bool,
) -> int:
    """Say whether calibrations of one sensor differ, what that means, and how they drift.

    Exit 0 they agree, 1 they differ beyond the limit, 5 the files are too uncertain to tell.

    \b
    Examples:
      imucal compare spring/calibration.yaml autumn/calibration.yaml --limit 2mg
      imucal compare 20*/calibration.yaml --html chart.html
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.checking.noise import limits_of, sessions_of
    from imucalib.calibration.comparison.compare import compared
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file
    from imucalib.report.comparison import comparison_dict, comparison_document
    from imucalib.report.files import shown_dict

    if html is not None:
        demand_output(html, calibrations, force=options["force"])
    if effects_file is not None:
        load_file(effects_file)
    wanted = limits_of(limits)
    loaded = [read(path) for path in calibrations]
    for calibration, path in zip(loaded, calibrations, strict=True):
        check(calibration, str(path))
    found = compared(
        loaded,
        _names(calibrations),
        wanted,
        dates.split(",") if dates else (),
        sessions_of(between),
    )
    document = comparison_document(found, calibrations, command_line())
    present(document, {**comparison_dict(found), **shown_dict(document)}, options, html)
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
