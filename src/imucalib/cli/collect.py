"""imucal collect"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli import options as opt
from imucalib.cli.output import note


@opt.paged(
    "collect",
    click.argument("folder", type=opt.FOLDER),
    opt.option(
        "-o --output",
        "Table to write: .csv, or .parquet (extra parquet).",
        required=True,
        type=opt.PATH,
    ),
    opt.option("--html", "Page of all recordings, those to look at first.", type=opt.FILE),
    opt.force,
    opt.quiet,
)
def command(folder: Path, output: Path, html: Path | None, force: bool, quiet: bool) -> int:
    """Gather the entries that `imucal batch`, or --entry of a calibrator, wrote into one table, a
    row a recording.

    \b
    Example: imucal collect entries -o cohort.csv --html cohort.html
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.file import write_whole
    from imucalib.cohort.entries import read_entry, rows, write_table
    from imucalib.errors import UnreadableInput
    from imucalib.report.cohort import cohort_html

    if not folder.is_dir():
        raise UnreadableInput(
            "no such folder", where=str(folder), remedy="name that of `imucal batch -o`"
        )
    paths = sorted(folder.glob("*.json"))
    for target in filter(None, (output, html)):
        demand_output(target, paths, force=force)
    found = [read_entry(path) for path in sorted(paths, key=lambda path: path.stat().st_mtime)]
    read = [entry for entry in found if entry is not None]
    entries = tuple({entry.recording: entry for entry in read}.values())
    if not entries:
        raise UnreadableInput(
            "no entries of a cohort in it",
            where=str(folder),
            remedy="`imucal batch MANIFEST -o FOLDER` writes them",
        )
    table = rows(entries)
    write_table(table, output)
    if html is not None:
        write_whole(html, cohort_html(table, folder.absolute().name))
    if len(read) < len(found):
        note(f"{len(found) - len(read)} files are no entries", quiet)
    if len(entries) < len(read):
        note(f"{len(read) - len(entries)} entries are older ones of the same recording", quiet)
    if not quiet:
        for target in filter(None, (output, html)):
            click.echo(f"wrote {target}: {len(entries)} recordings")
    return 0
