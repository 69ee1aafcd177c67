"""imucal export"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.exports import Made


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
    "--random-walk",
    default="limit",
    show_default=True,
    metavar="limit|ACC,GYRO",
    help="Random walks that the rests do not show: their upper limits, or values in SI.",
)
@click.option(
    "--device-id",
    metavar="ACC[,GYRO]",
    help="px4, ardupilot: the sensors' ids, as CAL_ACC0_ID and CAL_GYRO0_ID, or INS_ACC_ID and "
    "INS_GYR_ID, have them.",
)
@click.option(
    "--effects",
    "effects_file",
    type=click.Path(path_type=Path),
    help="Python file with effects of your own that the calibration uses.",
)
@click.option(
    "--largest-loss",
    metavar="MG[,DPS]",
    help="Loss, mg of a force and deg/s of a rate, from which on only --force writes; default: "
    "three times the error that the calibration leaves.",
)
@force_option
@json_option
@quiet_option
def command(
    calibration: Path,
    form: str,
    output: Path | None,
    noise: Path | None,
    random_walk: str,
    effects_file: Path | None,
    device_id: str | None,
    largest_loss: str | None,
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

    bounds = _bounds(largest_loss)
    if output is not None:
        demand_output(output, filter(None, (calibration, noise, effects_file)), force=force)
    if effects_file is not None:
        load_file(effects_file)
    loaded = _with_ids(_with_noise(read(calibration), noise, random_walk), form, device_id)
    check(loaded, str(calibration))
    source = str(dict(loaded.facts.get("provenance", {})).get("input", calibration.name))
    made = exported(loaded, source, form)
    if not force:
        demand_carried(made, form, loaded, *bounds)
    files = _files(made, output)
    for path in files:
        if path != output:
            demand_output(path, (), force=force)
    for path, text in files.items():
        write_whole(path, text)
    for text in made.lost:
        note(f"{form} lacks {text}", quiet)
    if as_json:
        place = {"files": [str(path) for path in files]} if files else {"text": made.text}
        emit_json({"form": form, **place, "lost": list(made.lost), **_losses(made)})
    elif not quiet or not files:
        said = "\n".join(f"wrote {path}" for path in files)
        click.echo(said or made.text, nl=bool(files))
    return 0


def _with_noise(calibration: Calibration, noise: Path | None, walks: str) -> Calibration:
    """What is told of the noise beside the calibration."""
    from imucalib.exports.imus import with_noise, with_walks

    if noise is not None:
        calibration = with_noise(calibration, noise)
    return calibration if walks == "limit" else with_walks(calibration, *_two(walks))


def _with_ids(calibration: Calibration, form: str, text: str | None) -> Calibration:
    """With the ids that are stated; raises click's usage errors."""
    from imucalib.exports.per_axis import FLIGHT, with_ids

    if text is None:
        return calibration
    if form not in FLIGHT:
        raise click.UsageError(f"--device-id is for {' and '.join(FLIGHT)}")
    words = text.split(",")
    if len(words) > 2 or not all(word.strip().isdigit() for word in words):
        said = "give the accelerometer's id, or ACC,GYRO: whole numbers"
        raise click.BadParameter(said, param_hint="--device-id")
    return with_ids(calibration, tuple(int(word) for word in words))


def _bounds(text: str | None) -> tuple[float | None, float | None]:
    """mg and deg/s, None where it is not stated; raises click's usage error."""
    if text is None:
        return None, None
    try:
        first, *more = map(float, text.split(","))
    except ValueError:
        first, more = -1.0, []
    if len(more) > 1 or not all(value >= 0.0 for value in (first, *more)):
        said = "give MG or MG,DPS: a force in mg, a rate in deg/s, zero or more"
        raise click.BadParameter(said, param_hint="--largest-loss")
    return first, more[0] if more else None


def _losses(made: Made) -> dict[str, float]:
    return {"loss_mg": made.loss, "loss_deg_per_s": made.rate_loss}


def _two(text: str) -> tuple[float, float]:
    """Two positive numbers; raises click's usage error."""
    try:
        first, second = map(float, text.split(","))
    except ValueError:
        first = second = -1.0
    if not (first > 0.0 and second > 0.0):
        raise click.BadParameter(
            "give limit, or ACC,GYRO in m/s3/sqrt(Hz), rad/s2/sqrt(Hz)", param_hint="--random-walk"
        )
    return first, second


def _files(made: Made, output: Path | None) -> dict[Path, str]:
    """What is written where: one file, or one an IMU with its name before the suffix."""
    if output is None:
        return {}
    if not made.files:
        return {output: made.text}
    names = {name: re.sub(r"[^\w.-]+", "_", name) for name in made.files}
    return {
        output.with_name(f"{output.stem}-{names[name]}{output.suffix}"): text
        for name, text in made.files.items()
    }
