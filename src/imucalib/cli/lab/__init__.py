"""imucal lab"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.calibrating import calibrating, calibrating_of, finish
from imucalib.cli.lab.options import lab_options, request_of
from imucalib.cli.options import PagedCommand, mapping_of, pairs, shortest_rest_option
from imucalib.cli.output import freed_memory

#: Bytes: a search takes the same few arrays again and again, and of hundreds of rows a quarter of
#: its time went into pages that the system clears anew for each.
_KEPT = 1 << 29


@click.command("lab", cls=PagedCommand, short_help="Calibrate on a bench with known angles.")
@click.argument(
    "tables", metavar="TABLE...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@lab_options
@shortest_rest_option
@calibrating
def command(tables: tuple[Path, ...], **options: Any) -> int:
    """Calibrate a tool's accelerometer on a bench with known tool-face and inclination.

    TABLE is a CSV or HDF5 file with one row a position. Several are power-ups of one sensor, as is
    a column session: what changes between them is told. Writes calibration.yaml, report.html and
    report.json into the folder given by -o, and prints the report.

    \b
    Examples:
      imucal lab positions.csv -o out --gravity 9.8061
      imucal lab positions.csv -o out --recording log.mcap
      imucal lab rests.csv -o out --reference norm --latitude 59.3
      imucal lab monday.csv tuesday.csv friday.csv -o out
    """
    from imucalib.calibrators.lab.files import LabFiles, calibrate_files
    from imucalib.report.files import Report
    from imucalib.report.lab import lab_document

    freed_memory(large=_KEPT, kept=_KEPT)
    files = LabFiles(
        tables[0],
        options["recording"],
        pairs(options["columns"], "--columns"),
        mapping_of(options),
        others=tables[1:],
    )
    with calibrating_of(options) as say:
        run = calibrate_files(files, request_of(options), say)
    return finish([Report(run, lab_document(run))], options)
