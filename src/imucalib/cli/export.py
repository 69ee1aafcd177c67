"""imucal export"""

from __future__ import annotations

from pathlib import Path

import click

from imucalib.cli.options import (
    EXPORT_FORM,
    FormOption,
    PagedCommand,
    force_option,
    json_option,
    quiet_option,
)
from imucalib.cli.output import emit_json, note


@click.command("export", cls=PagedCommand, short_help="Write coefficients for another program.")
@click.argument("calibration", type=click.Path(path_type=Path))
@click.option(
    "--to",
    "form",
    required=True,
    type=EXPORT_FORM,
    cls=FormOption,
    help="Form of the other program",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    help="File to write; default: stdout.",
)
@click.option(
    "--noise",
    type=click.Path(path_type=Path),
    help="Noise of the sensors, from `imucal inspect --save-noise`.",
)
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own that the calibration uses.",
)
@click.option(
    "--largest-loss",
    type=click.FloatRange(min=0.0),
    metavar="MG",
    help="Loss, mg of a force, from which on only --force writes; default: three times "
    "the error that the calibration leaves.",
)
@force_option
@json_option
@quiet_option
def command(
    calibration: Path,
    form: str,
    output: Path | None,
    noise: Path | None,
    effects_file: Path | None,
    largest_loss: float | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Write a calibration's coefficients in the form of another program.

    What the form cannot carry is said in the file and on stderr, in mg and deg; beyond a bound
    (--largest-loss) nothing is written, exit 1. A form that cannot hold the calibration at all
    refuses it.

    \b
    Examples:
      imucal export out/calibration.yaml --to c-header -o calibration.h
      imucal export out/calibration.yaml --to kalibr --noise imu.yaml -o imus.yaml
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.file import check, read, write_whole
    from imucalib.effects import load_file
    from imucalib.exports import exported
    from imucalib.exports.bound import demand_carried
    from imucalib.exports.imus import with_noise

    if output is not None:
        demand_output(output, filter(None, (calibration, noise, effects_file)), force=force)
    if effects_file is not None:
        load_file(effects_file)
    loaded = read(calibration)
    check(loaded, str(calibration))
    if noise is not None:
        loaded = with_noise(loaded, noise)
    source = str(dict(loaded.facts.get("provenance", {})).get("input", calibration.name))
    made = exported(loaded, source, form)
    if not force:
        demand_carried(made, form, loaded, largest_loss)
    if output is not None:
        write_whole(output, made.text)
    for text in made.lost:
        note(f"{form} lacks {text}", quiet)
    if as_json:
        place = {"output": str(output)} if output else {"text": made.text}
        emit_json({"form": form, **place, "lost": list(made.lost), "loss_mg": made.made.loss})
    elif output is None:
        click.echo(made.text, nl=False)
    elif not quiet:
        click.echo(f"wrote {output}")
    return 0
