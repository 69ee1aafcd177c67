"""imucal validate"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli import options as opt
from imucalib.cli.output import emit_json


@opt.paged("validate", click.argument("file", type=opt.PATH), opt.json, opt.quiet)
def command(file: Path, as_json: bool, quiet: bool) -> int:
    """Check that a calibration file is whole, known to this version, and can be applied.

    \b
    Example: imucal validate out/calibration.yaml
    """
    found = opt.calibration_of(file, None)
    count = len(found.parameters)
    if as_json:
        shown = {"status": found.status, "parameters": count}
        emit_json({"file": str(file), "valid": True, **shown})
    elif not quiet:
        what = f"valid {found.calibrator} calibration, status {found.status}"
        click.echo(f"{file}: {what}, {count} parameters")
    return 0
