"""imucal export: Write a calibration's coefficients for another program."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import emit_json, note
from imucalib.data import Data

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.exports import Made


#: Below any sensor's, in SI.
_LEAST_WALK = 1e-12


class Exported(Data, name="export/1"):
    """Coefficients in the form of another program."""

    form: str
    lost: Annotated[tuple[str, ...], "What the form cannot carry."]
    loss_mg: Annotated[float, "Error of a force that this makes."]
    loss_deg_per_s: Annotated[float | None, "Error of a rate that this makes."]
    files: Annotated[tuple[str, ...] | None, "That were written."] = None
    text: Annotated[str | None, "Where no file was asked for."] = None


@opt.command_with_page("export")
@click.argument("calibration", type=opt.PATH)
@opt.option(
    "--to form",
    "Form of the other program",
    required=True,
    type=opt.EXPORT_FORM,
    cls=opt.FormOption,
)
@opt.file("-o --output", "File to write; default: stdout.")
@opt.path("--noise", "Noise of the sensors, from `imucal noise --to kalibr`.")
@opt.option(
    "--random-walk",
    "Random walks that the rests do not show: their upper limits, or values in SI.",
    default="limit",
    metavar="limit|ACC,GYRO",
)
@opt.option(
    "--device-id",
    "px4, ardupilot: the sensors' ids, as CAL_ACC0_ID and CAL_GYRO0_ID, or INS_ACC_ID and "
    "INS_GYR_ID, have them.",
    metavar="ACC[,GYRO]",
)
@opt.option("--name", "Name of the sensor in the file; default: as its recording calls it.")
@opt.effects
@opt.option(
    "--largest-loss",
    "Loss, mg of a force and deg/s of a rate, from which on only --force writes; default: "
    "what makes the form no better than the raw reading.",
    metavar="MG[,DPS]",
)
@opt.line_options
def command(calibration: Path, form: str, output: Path | None, **options: Any) -> int:
    """Write a calibration's coefficients in the form of another program.

    What the form cannot carry is said in the file and on stderr, in mg and deg; beyond a bound
    (--largest-loss) nothing is written, exit 1. A form that cannot hold the calibration at all
    refuses it.

    \b
    Examples:
      imucal export out/calibration.yaml --to c-header -o calibration.h
      imucal export out/calibration.yaml --to kalibr --noise imu.yaml -o imus.yaml
    """
    from imucalib.calibration.file import write_together
    from imucalib.exports import demand_carried, export

    bounds: tuple[float | None, ...] = (None,)
    if (text := options["largest_loss"]) is not None:
        written = "MG or MG,DPS: a force in mg, a rate in deg/s, zero or more"
        bounds = opt.numbers_of(text, "--largest-loss", written, {1, 2}, 0.0)
    opt.demand_outputs(options, [output], calibration)
    loaded = _apply_stated(opt.calibration_of(calibration, options), form, options)
    source = str(dict(loaded.facts.get("provenance", {})).get("input", calibration.name))
    made = export(loaded, source, form)
    if not options["force"]:
        demand_carried(made, form, loaded, *bounds)
    files = _files(made, output)
    opt.demand_outputs(options, (path for path in files if path != output))
    write_together(files)
    for text in made.lost:
        note(f"{form} lacks {text}", options["quiet"])
    if options["as_json"]:
        emit_json(
            Exported(
                form=form,
                lost=made.lost,
                loss_mg=made.loss,
                loss_deg_per_s=made.rate_loss,
                files=tuple(map(str, files)) or None,
                text=None if files else made.text,
            )
        )
    elif not options["quiet"] or not files:
        said = "\n".join(f"wrote {path}" for path in files)
        click.echo(said or made.text, nl=bool(files))
    return 0


def _apply_stated(calibration: Calibration, form: str, options: dict[str, Any]) -> Calibration:
    """With the noise and the ids that are stated beside it; raises click's usage errors."""
    from imucalib.exports.flight import FLIGHT, state_ids
    from imucalib.exports.imus import state_noise, state_walks
    from imucalib.recording.identity import NAMELESS
    from imucalib.recording.pairing import fault

    if options["name"] is not None:
        if why := fault(options["name"]):
            raise click.BadParameter(why, param_hint="--name")
        own = calibration.sensor or NAMELESS
        calibration = replace(calibration, sensor=replace(own, name=options["name"]))
    if options["noise"] is not None:
        calibration = state_noise(calibration, options["noise"])
    if (walks := options["random_walk"]) != "limit":
        written = "limit, or ACC,GYRO in m/s3/sqrt(Hz), rad/s2/sqrt(Hz)"
        values = opt.numbers_of(walks, "--random-walk", written, {2}, _LEAST_WALK)
        calibration = state_walks(calibration, *values)
    if (ids := options["device_id"]) is None:
        return calibration
    if form not in FLIGHT:
        raise click.UsageError(f"--device-id is for {' and '.join(FLIGHT)}")
    words = ids.split(",")
    if len(words) > 2 or not all(word.strip().isdigit() for word in words):
        said = "give the accelerometer's id, or ACC,GYRO: whole numbers"
        raise click.BadParameter(said, param_hint="--device-id")
    return state_ids(calibration, tuple(int(word) for word in words))


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
