"""imucal inspect"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli import options as opt
from imucalib.cli.output import note, present, working

if TYPE_CHECKING:
    from imucalib.report.document import Document


@opt.paged("inspect")
@click.argument("file", type=opt.PATH)
@opt.path("--save-mapping", "Write how the file was read, for --mapping.")
@opt.flag("--rests", "List every candidate for a rest, and what refused it.")
@opt.flag(
    "--noise", "White noise, bias instability and random walk of every axis, from what is still."
)
@opt.path(
    "--save-noise",
    "Write that noise as Kalibr's imu.yaml has it, also for `imucal export --noise`.",
)
@opt.path("--html", "Also write all of it as a page, with plots.")
@opt.shortest_rest
@opt.flag("--strict", "Refuse a damaged recording instead of reading what is left.")
@opt.force
@opt.recording
@opt.full
@opt.json
@opt.quiet
def command(file: Path, **options: Any) -> int:
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
    from imucalib.inspection.noise import noise_at_rest, save_noise
    from imucalib.readers import blocks
    from imucalib.recording.mapping import from_dict, save_mapping
    from imucalib.report.inspection import inspection_dict, inspection_document

    mapping_file, noise_file, page = (options[n] for n in ("save_mapping", "save_noise", "html"))
    for output in filter(None, (mapping_file, noise_file, page)):
        demand_output(output, opt.inputs_of(options, file), force=options["force"])
    typed, rests = _typed(file), options["rests"]
    noisy = options["noise"] or noise_file
    if not (mapping_file or noisy or rests) and (seen := _no_recording(file, typed, options)):
        present(*seen, options, page)
        return 0
    settings, mapping, strict = opt.still_of(options), opt.mapping_of(options), options["strict"]
    with working("reading", quiet=options["quiet"]):
        found, noise = inspect_recording(blocks(file, mapping, strict=strict), settings), None
        if noisy:
            still = found.still  # whose noise takes a second pass
            again = blocks(file, mapping, strict=strict)
            noise = () if still is None else noise_at_rest(again, still)
    document = inspection_document(found, typed, rests=rests, noise=noise)
    if noise_file is not None:
        save_noise(noise or (), file.name, noise_file)
        note(f"wrote {noise_file}", options["quiet"])
    if mapping_file is not None:
        save_mapping(from_dict(found.mapping), mapping_file)
        note(f"wrote {mapping_file}", options["quiet"])
    content = inspection_dict(found, typed, rests=rests, noise=noise)
    present(document, content, options, page)
    return 0


def _typed(file: Path) -> str:
    """The file and what was typed of its reading, for the next command."""
    ctx = click.get_current_context()
    words = [str(file)]
    for parameter in ctx.command.params:
        name = parameter.name or ""
        source = ctx.get_parameter_source(name)
        if name not in opt.READING or source is not click.core.ParameterSource.COMMANDLINE:
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
    seen = inspect_table(file, opt.mapping_of(options))
    return None if seen is None else (table_document(seen, typed), table_dict(seen, typed))
