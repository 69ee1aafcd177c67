"""imucal noise: Say how noisy sensors are at rest, and write it for Kalibr, VINS and others."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import note, present, working


def _forms() -> tuple[str, ...]:
    from imucalib.exports.noise import NOISE_FORMS

    return tuple(NOISE_FORMS)


@opt.command_with_page("noise")
@click.argument("recording", type=opt.PATH)
@opt.option(
    "--to form", "Write it for another program", type=opt.FormName(_forms), cls=opt.FormOption
)
@opt.file("-o --output", "File of --to; default: stdout, in place of the table.")
@opt.path("--html", "Also write all of it as a page, with the Allan deviations drawn.")
@opt.shortest_rest
@opt.strict
@opt.recording
@opt.page_options
def command(recording: Path, form: str | None, output: Path | None, **options: Any) -> int:
    """Say how noisy sensors are at rest, in the units that people use, and write it for others.

    White noise, bias instability, random walk and ramp of every axis with 95 % intervals, by the
    overlapping Allan variance of all that is still. A minute shows white noise, hours the rest.

    \b
    Examples:
      imucal noise still_night.mcap --html noise.html
      imucal noise still_night.mcap --to kalibr -o imu.yaml
    """
    from imucalib.calibration.file import write_whole
    from imucalib.errors import Undetermined
    from imucalib.exports.noise import noise_text
    from imucalib.inspection.noise import noise_at_rest
    from imucalib.readers import blocks
    from imucalib.report.noise import compose_noise_document, describe_noise
    from imucalib.rests.segments import find_segments

    if output is not None and form is None:
        raise click.UsageError("--output is the file of a form: name it with --to")
    opt.demand_outputs(options, [output], recording)
    settings, mapping, strict = opt.still_of(options), opt.mapping_of(options), options["strict"]
    with working("reading", quiet=options["quiet"]):
        still = find_segments(blocks(recording, mapping, strict=strict), settings)
        noise = noise_at_rest(blocks(recording, mapping, strict=strict), still)
    if not noise:
        raise Undetermined(
            "nothing with a scale is still for long enough to tell its noise",
            where=str(recording),
            remedy="record at rest for a minute or more; `imucal inspect` with --rests says what "
            "refused each rest",
        )
    if form is not None:
        text = noise_text(noise, form, recording.name)
        if output is None:
            click.echo(text, nl=False)
            return 0
        write_whole(output, text)
        note(f"wrote {output}", options["quiet"])
    document = compose_noise_document(str(recording), noise, opt.repeat_typed(recording))
    present(document, describe_noise(str(recording), noise), options)
    return 0
