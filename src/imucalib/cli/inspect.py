"""imucal inspect"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.options import (
    READING,
    PagedCommand,
    force_option,
    full_option,
    inputs_of,
    json_option,
    mapping_of,
    quiet_option,
    recording_options,
    shortest_rest_option,
    still_of,
)
from imucalib.cli.output import note, present, working

if TYPE_CHECKING:
    from imucalib.inspection.inspection import Inspection
    from imucalib.inspection.noise import SensorNoise
    from imucalib.report.document import Document


@click.command("inspect", cls=PagedCommand, short_help="Say what a file holds.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--save-mapping",
    type=click.Path(path_type=Path),
    help="Write how the file was read, for --mapping.",
)
@click.option("--rests", is_flag=True, help="List every candidate for a rest, and what refused it.")
@click.option(
    "--noise",
    is_flag=True,
    help="White noise, bias instability and random walk of every axis, from what is still.",
)
@click.option(
    "--save-noise",
    type=click.Path(path_type=Path),
    help="Write that noise as Kalibr's imu.yaml has it, also for `imucal export --noise`.",
)
@click.option(
    "--html", type=click.Path(path_type=Path), help="Also write all of it as a page, with plots."
)
@shortest_rest_option
@click.option(
    "--strict", is_flag=True, help="Refuse a damaged recording instead of reading what is left."
)
@force_option
@recording_options
@full_option
@json_option
@quiet_option
def command(
    file: Path,
    save_mapping: Path | None,
    rests: bool,
    noise: bool,
    save_noise: Path | None,
    html: Path | None,
    strict: bool,
    force: bool,
    **options: Any,
) -> int:
    """Say what a recording or a table of positions holds, what is wrong with it, and what to type.

    Channels, units, rates, gaps and the norm at rest; or columns, rows and sizes of readings. The
    same as `imucal FILE`.

    \b
    Examples:
      imucal inspect log.mcap --save-mapping mapping.yaml
      imucal inspect log.mcap --rests --html rests.html
      imucal inspect still_night.mcap --noise --save-noise imu.yaml
    """
    from imucalib.atomic_file import demand_output
    from imucalib.inspection.inspection import inspect_recording
    from imucalib.inspection.noise import save_noise as noise_file
    from imucalib.readers import blocks
    from imucalib.recording.mapping import from_dict
    from imucalib.recording.mapping import save_mapping as save
    from imucalib.report.inspection import inspection_dict, inspection_document

    for output in (save_mapping, save_noise, html):
        if output is not None:
            demand_output(output, inputs_of(options, file), force=force)
    typed, wanted = _typed(file), (save_mapping, save_noise, rests, noise)
    if not any(wanted) and (seen_as := _no_recording(file, typed, options)) is not None:
        present(*seen_as, options, html)
        return 0
    settings = still_of(options)
    with working("reading", quiet=options["quiet"]):
        found = inspect_recording(blocks(file, mapping_of(options), strict=strict), settings)
        seen = _noise(found, file, options, strict) if noise or save_noise else None
    document = inspection_document(found, typed, rests=rests, noise=seen)
    if save_noise is not None:
        noise_file(seen or (), file.name, save_noise)
        note(f"wrote {save_noise}", options["quiet"])
    if save_mapping is not None:
        save(from_dict(found.mapping), save_mapping)
        note(f"wrote {save_mapping}", options["quiet"])
    content = inspection_dict(found, typed, rests=rests, noise=seen)
    present(document, content, options, html)
    return 0


def _typed(file: Path) -> str:
    """The file and what was typed of its reading, for the next command."""
    ctx = click.get_current_context()
    words = [str(file)]
    for parameter in ctx.command.params:
        name = parameter.name or ""
        source = ctx.get_parameter_source(name)
        if name not in READING or source is not click.core.ParameterSource.COMMANDLINE:
            continue
        value = ctx.params[name]
        for one in value if isinstance(value, tuple) else (value,):
            words += [parameter.opts[0]] if value is True else [parameter.opts[0], str(one)]
    return shlex.join(words)


def _no_recording(
    file: Path, typed: str, options: dict[str, Any]
) -> tuple[Document, dict[str, Any]] | None:
    """What is to be said of a file of this program or of a table of positions; None of another."""
    from imucalib.calibrators.lab.files import inspect_table
    from imucalib.report.inspection import own_document, table_dict, table_document

    if file.is_file() and (own := own_document(file, typed)):
        return own
    seen = inspect_table(file, mapping_of(options))
    return None if seen is None else (table_document(seen, typed), table_dict(seen, typed))


def _noise(
    found: Inspection, file: Path, options: dict[str, Any], strict: bool
) -> tuple[SensorNoise, ...]:
    """A second pass over what is still."""
    from imucalib.inspection.noise import noise_at_rest
    from imucalib.readers import blocks

    if found.still is None:
        return ()
    return noise_at_rest(blocks(file, mapping_of(options), strict=strict), found.still)
