"""imucal validate"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli.options import PagedCommand, json_option, quiet_option
from imucalib.cli.output import emit_json


@click.command("validate", cls=PagedCommand, short_help="Check a calibration file.")
@click.argument("file", type=click.Path(path_type=Path))
@json_option
@quiet_option
def command(file: Path, as_json: bool, quiet: bool) -> int:
    """Check that a calibration file is whole, known to this version, and can be applied.

    \b
    Example: imucal validate out/calibration.yaml
    """
    from imucalib.calibration.file import check, read

    calibration = read(file)
    check(calibration, str(file))
    if as_json:
        emit_json(
            {
                "file": str(file),
                "valid": True,
                "status": calibration.status,
                "parameters": len(calibration.parameters),
            }
        )
    elif not quiet:
        click.echo(
            f"{file}: valid {calibration.calibrator} calibration, status {calibration.status}, "
            f"{len(calibration.parameters)} parameters"
        )
    return 0
