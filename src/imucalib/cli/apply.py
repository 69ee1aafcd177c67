"""imucal apply"""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.options import (
    PagedCommand,
    force_option,
    inputs_of,
    json_option,
    mapping_of,
    quiet_option,
    recording_options,
)
from imucalib.cli.output import emit_json, note, say, working

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration


def _millimetres(
    ctx: click.Context, param: click.Parameter, text: str | None
) -> tuple[float, ...] | None:
    """ "1.5,0,-2" as a point."""
    if text is None:
        return None
    try:
        point = tuple(float(part) for part in text.split(","))
    except ValueError:
        point = ()
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise click.BadParameter(f"'{text}' is no point: three numbers, mm", ctx, param)
    return point


@click.command("apply", cls=PagedCommand, short_help="Correct a recording with a calibration.")
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
@click.option(
    "--angles",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write inclination and tool-face with their sd, as CSV.",
)
@click.option(
    "--each",
    type=click.Choice(["rest", "sample"]),
    default="rest",
    show_default=True,
    help="A row of --angles for each rest, or for each sample.",
)
@click.option(
    "--fused/--no-fused",
    default=None,
    help="Of an array: only the fused virtual IMU, or only the IMUs; default: both.",
)
@click.option(
    "--at",
    metavar="X,Y,Z",
    callback=_millimetres,
    help="Of an array: point of the board's drawing whose force is given, mm; default: the middle.",
)
@click.option(
    "--residuals",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also write what rests read before and after, and the corrected sensors, to look at: "
    ".mcap, with a layout for Foxglove.",
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
    fused: bool | None,
    at: tuple[float, ...] | None,
    again: bool,
    angles: Path | None,
    each: str,
    residuals: Path | None,
    force: bool,
    **options: Any,
) -> int:
    """Correct the acceleration of a recording; everything else stays as it was.

    With the calibration of an array, the readings of every IMU in board axes, and all of them fused
    into one: force, rate and angular acceleration with their covariances.

    \b
    Examples:
      imucal apply out/calibration.yaml run.mcap -o corrected.mcap
      imucal apply out/calibration.yaml run.mcap -o new.mcap --angles angles.csv
      imucal apply out/calibration.yaml run.mcap -o new.mcap --residuals r.mcap
      imucal apply array/calibration.yaml run.mcap --fused -o fused.mcap
    """
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file
    from imucalib.writers import writer_for
    from imucalib.writers.residuals import residual_files

    writer_for(output)
    made = [
        output,
        *([angles] if angles else []),
        *(residual_files(residuals) if residuals else ()),
    ]
    for path in made:
        demand_output(path, inputs_of(options, calibration, recording), force=force)
    if options["effects_file"] is not None:
        load_file(options["effects_file"])
    loaded = read(calibration)
    check(loaded, str(calibration))
    _refuse_angles(loaded, angles)
    if loaded.status != "ok":
        note(
            f"warning: this calibration is {loaded.status}: {'; '.join(loaded.reasons)}",
            options["quiet"],
        )
    given = {"triad": triad, "use": use, "fused": fused, "at": at, "strict": strict, "again": again}
    with working("correcting", quiet=options["quiet"]):
        notes = _applied(loaded, recording, output, {**options, **given})
        frame = _angles(loaded, output, angles, triad, each) if angles is not None else ""
        if residuals is not None:
            _residuals(loaded, recording, residuals, {**options, **given})
    for text in (*notes, *filter(None, [frame])):
        note(text, options["quiet"])
    if options["as_json"]:
        emit_json({"output": str(output), "notes": list(notes)})
    elif not options["quiet"]:
        for path in made:
            say(f"wrote {path}")
    return 0


def _refuse_angles(calibration: Calibration, path: Path | None) -> None:
    """Angles are of one accelerometer; said before anything is written."""
    from imucalib.errors import UsageError

    if path is not None and calibration.triads:
        raise UsageError(
            "--angles is of one accelerometer, this calibration is of an array",
            remedy="leave it out: the fused specific force at rest has the array's tilt",
        )


def _angles(
    calibration: Calibration, corrected: Path, path: Path, triad: str | None, each: str
) -> str:
    """Write the angles of the corrected recording; what must be said of their frame."""
    from imucalib.calibration.angles import angles_at_rests, angles_of_samples
    from imucalib.calibrators.lab.conventions import Conventions
    from imucalib.readers import read
    from imucalib.report.files import write_angles
    from imucalib.rests.segments import still_segments

    recording = read(corrected)
    rests = still_segments(recording)
    found = [c for c in recording.channels.values() if c.quantity == "acceleration"]
    channel = next(c for c in found if triad is None or c.triad == triad)
    k = rests.triads.index(channel.triad)
    if each == "rest":
        angles = angles_at_rests(calibration, channel.values, rests, k)
    else:
        angles = angles_of_samples(calibration, channel.values, channel.t, rests, k)
    stated = calibration.facts.get("conventions")
    write_angles(angles, Conventions(**stated) if stated else Conventions(), path)
    if stated:
        return ""
    return "angles are in the sensor's own axes: no bench has tied them to a tool"


def _residuals(calibration: Calibration, source: Path, path: Path, options: dict[str, Any]) -> None:
    """Write what rests read before and after."""
    from imucalib.calibration.residuals import with_residuals
    from imucalib.readers import read
    from imucalib.writers.residuals import write_residuals

    recording = read(source, mapping_of(options), strict=options["strict"])
    chosen = {name: options[name] for name in ("triad", "use", "again")}
    write_residuals(with_residuals(calibration, recording, **chosen), path)


def _applied(
    calibration: Calibration, source: Path, target: Path, options: dict[str, Any]
) -> tuple[str, ...]:
    """Each sensor corrected, the array fused, or both; and what there is to say of it."""
    from imucalib.calibration.apply import correct_file

    mapping, fused = mapping_of(options), options["fused"]
    both = {"strict": options["strict"], "again": options["again"]}
    alone = options["triad"] is not None or options["use"] is not None or not calibration.triads
    words: tuple[str, ...] = ()
    if fused or options["at"] is not None or (fused is None and not alone):
        import numpy as np

        from imucalib.calibrators.array.fused.recording import fuse_file
        from imucalib.calibrators.array.fused.survey import NotFusable

        if fused is False or options["triad"] is not None:
            raise click.UsageError("--at and --fused are of all IMUs together: leave the other out")
        point = options["at"] and 1e-3 * np.array(options["at"])
        try:
            return fuse_file(calibration, source, target, mapping, at=point, each=not fused, **both)
        except NotFusable as error:
            if fused or point is not None:
                raise
            words = (f"not fused: {error.what}",)
    notes = correct_file(
        calibration, source, target, mapping, triad=options["triad"], use=options["use"], **both
    )
    return (*notes, *words)
