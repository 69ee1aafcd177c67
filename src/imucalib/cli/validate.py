"""imucal validate"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli.options import PATH, calibration_of, json_option, paged, quiet_option
from imucalib.cli.output import emit_json


@paged("validate", click.argument("file", type=PATH), json_option, quiet_option)
def command(file: Path, as_json: bool, quiet: bool) -> int:
    """Check that a calibration file is whole, known to this version, and can be applied.

    \b
    Example: imucal validate out/calibration.yaml
    """
    found = calibration_of(file, None)
    count = len(found.parameters)
    if as_json:
        shown = {"status": found.status, "parameters": count}
        emit_json({"file": str(file), "valid": True, **shown})
    elif not quiet:
        what = f"valid {found.calibrator} calibration, status {found.status}"
        click.echo(f"{file}: {what}, {count} parameters")
    return 0
