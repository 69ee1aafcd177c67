"""imucal inspect"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.output import color, emit_json, json_option, note, quiet_option, width
from imucalib.cli.recording_options import (
    force_option,
    inputs_of,
    mapping_of,
    recording_options,
    shortest_rest_option,
    still_of,
)
from imucalib.cli.working import working


@click.command("inspect", short_help="Say what a recording holds.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--save-mapping",
    type=click.Path(path_type=Path),
    help="Write how the file was read, for --mapping.",
)
@click.option("--rests", is_flag=True, help="List every candidate for a rest, and what refused it.")
@click.option(
    "--html", type=click.Path(path_type=Path), help="Also write all of it as a page, with plots."
)
@shortest_rest_option
@click.option(
    "--strict", is_flag=True, help="Refuse a damaged recording instead of reading what is left."
)
@force_option
@recording_options
@json_option
@quiet_option
def command(
    file: Path,
    save_mapping: Path | None,
    rests: bool,
    html: Path | None,
    strict: bool,
    force: bool,
    **options: Any,
) -> int:
    """Say what a recording holds: channels, units, rates, gaps, norm at rest, what would be used.

    \b
    Examples:
      imucal inspect log.mcap --save-mapping mapping.yaml
      imucal inspect log.mcap --rests --html rests.html
    """
    from imucalib.atomic_file import demand_output, replaced_atomically
    from imucalib.inspection.inspection import inspect_recording
    from imucalib.readers import blocks
    from imucalib.recording.mapping import from_dict
    from imucalib.recording.mapping import save_mapping as save
    from imucalib.report.inspection import inspection_dict, inspection_document
    from imucalib.report.render.text import render_text

    for output in (save_mapping, html):
        if output is not None:
            demand_output(output, inputs_of(options, file), force=force)
    settings = still_of(options)
    with working("reading", quiet=options["quiet"]):
        found = inspect_recording(blocks(file, mapping_of(options), strict=strict), settings)
    document = inspection_document(found, rests=rests)
    if save_mapping is not None:
        save(from_dict(found.mapping), save_mapping)
        note(f"wrote {save_mapping}", options["quiet"])
    if html is not None:
        from imucalib.report.render.html import render_html

        with replaced_atomically(html) as temporary:
            temporary.write_text(render_html(document), encoding="utf-8", errors="backslashreplace")
        note(f"wrote {html}", options["quiet"])
    if options["as_json"]:
        emit_json(inspection_dict(found, rests=rests))
    elif not options["quiet"]:
        click.echo(render_text(document, width(), color=color()), nl=False)
    return 0
