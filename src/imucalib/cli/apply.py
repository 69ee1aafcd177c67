"""imucal apply"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.output import emit_json, json_option, note, quiet_option, say
from imucalib.cli.recording_options import force_option, inputs_of, mapping_of, recording_options
from imucalib.cli.working import working


@click.command("apply", short_help="Correct a recording with a calibration.")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--output",
    required=True,
    type=click.Path(path_type=Path),
    help="File to write: .mcap, .h5 or .csv.",
)
@click.option(
    "--strict", is_flag=True, help="Refuse a damaged recording instead of keeping what is left."
)
@click.option("--triad", help="Which sensor, when the recording has several.")
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own that the calibration uses.",
)
@click.option(
    "--parts",
    "use",
    flag_value="parts",
    help="Each sample by the part valid at its time (--every).",
)
@click.option("--again", is_flag=True, help="Correct a recording that is corrected already.")
@click.option("--whole", "use", flag_value="whole", help="One calibration for all, whatever parts.")
@force_option
@recording_options
@json_option
@quiet_option
def command(
    calibration: Path,
    recording: Path,
    output: Path,
    strict: bool,
    triad: str | None,
    use: str | None,
    again: bool,
    force: bool,
    **options: Any,
) -> int:
    """Correct the acceleration of a recording; everything else stays as it was.

    \b
    Example: imucal apply out/calibration.yaml run.mcap -o corrected.mcap
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.apply import correct_file
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file
    from imucalib.writers import writer_for

    writer_for(output)
    demand_output(output, inputs_of(options, calibration, recording), force=force)
    if options["effects_file"] is not None:
        load_file(options["effects_file"])
    loaded = read(calibration)
    check(loaded, str(calibration))
    if loaded.status != "ok":
        note(
            f"warning: this calibration is {loaded.status}: {'; '.join(loaded.reasons)}",
            options["quiet"],
        )
    with working("correcting", quiet=options["quiet"]):
        notes = correct_file(
            loaded, recording, output, mapping_of(options), triad=triad, strict=strict, use=use,
            again=again,
        )  # fmt: skip
    for text in notes:
        note(text, options["quiet"])
    if options["as_json"]:
        emit_json({"output": str(output), "notes": list(notes)})
    elif not options["quiet"]:
        say(f"wrote {output}")
    return 0
