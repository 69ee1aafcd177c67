"""imucal convert"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli import options as opt
from imucalib.cli.output import emit_json, note, say, working


@opt.paged("convert")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True, type=opt.PATH)
@click.argument("target", type=opt.PATH)
@opt.strict
@opt.force
@opt.recording
@opt.json
@opt.quiet
def command(
    sources: tuple[Path, ...], target: Path, strict: bool, force: bool, **options: Any
) -> int:
    """Rewrite a recording as MCAP, HDF5 or CSV, chosen by TARGET's suffix; units become SI.

    Several SOURCEs are files of one device with clocks of one zero, each of other sensors: they
    become one recording.

    \b
    Examples:
      imucal convert log.csv log.mcap --rate 100 --acc x,y,z
      imucal convert accelerometer.csv gyroscope.csv phone.h5
    """
    from imucalib.atomic_file import demand_output
    from imucalib.readers import blocks, read_together
    from imucalib.writers import ChannelsChange, Noted, write_blocks, writer_for

    writer_for(target)
    demand_output(target, opt.inputs_of(options, *sources), force=force)
    mapping = opt.mapping_of(options)
    if len(sources) == 1:
        noted = Noted(blocks(sources[0], mapping, strict=strict))
    else:
        noted = Noted([read_together(sources, mapping, strict=strict)])
    with working("converting", quiet=options["quiet"]):
        try:
            write_blocks(noted, target)
        except ChannelsChange:  # a table must know its columns first: then all of it is held
            noted = Noted([read_together(sources, mapping, strict=strict)])
            write_blocks(noted, target)
    for text in noted.notes:
        note(text, options["quiet"])
    if options["as_json"]:
        seen = {"channels": list(noted.channels), "notes": list(noted.notes)}
        emit_json({"output": str(target), **seen})
    elif not options["quiet"]:
        say(f"wrote {target}: {', '.join(noted.channels)}")
    return 0
