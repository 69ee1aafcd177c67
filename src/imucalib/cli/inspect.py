"""imucal inspect: Say what a file holds and how it would be read; also `imucal FILE`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import note, present, working

if TYPE_CHECKING:
    from imucalib.data import Data
    from imucalib.report.render.document import Document


@opt.command_with_page("inspect")
@click.argument("file", type=opt.PATH)
@opt.path("--save-mapping", "Write how the file was read, for --mapping.")
@opt.flag("--rests", "List every candidate for a rest, and what refused it.")
@opt.path("--html", "Also write all of it as a page, with plots.")
@opt.shortest_rest
@opt.flag("--strict", "Refuse a damaged recording instead of reading what is left.")
@opt.recording
@opt.page_options
def command(file: Path, **options: Any) -> int:
    """Say what a recording or a table of positions holds, what is wrong with it, and what to type.

    Channels, units, rates, gaps and the norm at rest; or columns, rows and sizes of readings. The
    same as `imucal FILE`.

    \b
    Examples:
      imucal inspect log.mcap --save-mapping mapping.yaml
      imucal inspect log.mcap --rests --html rests.html
    """
    from imucalib.inspection.inspection import inspect_recording
    from imucalib.readers import blocks
    from imucalib.recording.mapping import from_dict, save_mapping
    from imucalib.report.inspection import compose_inspection_document, describe_recording

    mapping_file = options["save_mapping"]
    opt.demand_outputs(options, [mapping_file], file)
    typed, rests = opt.repeat_typed(file), options["rests"]
    if not (mapping_file or rests) and (seen := _no_recording(file, typed, options)):
        present(*seen, options)
        return 0
    settings, mapping, strict = opt.still_of(options), opt.mapping_of(options), options["strict"]
    with working("reading", quiet=options["quiet"]):
        found = inspect_recording(blocks(file, mapping, strict=strict), settings)
    if mapping_file is not None:
        save_mapping(from_dict(found.mapping), mapping_file)
        note(f"wrote {mapping_file}", options["quiet"])
    document = compose_inspection_document(found, typed, rests=rests)
    present(document, describe_recording(found, typed, rests=rests), options)
    return 0


def _no_recording(file: Path, typed: str, options: dict[str, Any]) -> tuple[Document, Data] | None:
    """What is to be said of a file of this program or of a table of positions; None of another."""
    from imucalib.calibrators.lab.files import inspect_table
    from imucalib.report.inspection import (
        compose_own_document,
        compose_table_document,
        describe_table,
    )

    if file.is_file() and (own := compose_own_document(file, typed)):
        return own
    if (seen := inspect_table(file, opt.mapping_of(options))) is None:
        return None
    table = describe_table(seen, typed)
    return compose_table_document(table), table
