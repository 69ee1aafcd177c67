"""imucal apply: Correct a recording with a calibration.

imucal convert: Rewrite a recording in another format.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import note, tell, working
from imucalib.data import Data

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.recording.mapping import FieldMapping


class Corrected(Data, name="apply/1"):
    """A corrected recording."""

    output: str
    notes: tuple[str, ...]


class Converted(Data, name="convert/1"):
    """A recording in another format."""

    output: str
    channels: tuple[str, ...]
    notes: tuple[str, ...]


@opt.command_with_page("apply")
@click.argument("calibration", type=opt.PATH)
@click.argument("recording", type=opt.PATH)
@opt.path("-o --output", "File to write: .mcap, .h5 or .csv.", required=True)
@opt.strict
@opt.same_device
@opt.effects
@opt.option(
    "--parts use", "Each sample by the part valid at its time (--every).", flag_value="parts"
)
@opt.file("--angles", "Also write inclination and tool-face with their sd, as CSV.")
@opt.choice(
    "--each", "rest sample", "A row of --angles for each rest, or for each sample.", default="rest"
)
@opt.option(
    "--fused/--no-fused",
    "Of an array: only the fused virtual IMU, or only the IMUs; default: both.",
    default=None,
)
@opt.option(
    "--at",
    "Of an array: point of the board's drawing whose force is given, mm; default: the middle.",
    metavar="X,Y,Z",
)
@opt.file(
    "--residuals",
    "Also write what rests read before and after, and the corrected sensors, to look at: "
    ".mcap, with a layout for Foxglove.",
)
@opt.flag("--again", "Correct a recording that is corrected already.")
@opt.option("--whole use", "One calibration for all, whatever parts.", flag_value="whole")
@opt.recording
@opt.line_options
def command(calibration: Path, recording: Path, **options: Any) -> int:
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
    from imucalib.errors import UsageError
    from imucalib.writers import writer_for
    from imucalib.writers.residuals import residual_files

    output, angles, quiet = options["output"], options["angles"], options["quiet"]
    writer_for(output)
    pair = residual_files(options["residuals"]) if options["residuals"] else ()
    made = [output, *([angles] if angles else []), *pair]
    opt.demand_outputs(options, made, calibration, recording)
    loaded = opt.calibration_of(calibration, options)
    if angles is not None and loaded.triads:
        raise UsageError(
            "--angles is of one accelerometer, this calibration is of an array",
            remedy="leave it out: the fused specific force at rest has the array's tilt",
        )
    if loaded.status != "ok":
        note(f"warning: this calibration is {loaded.status}: {'; '.join(loaded.reasons)}", quiet)
    with working("correcting", quiet=quiet):
        notes, mapping = opt.read_as_calibrated(
            loaded, options, lambda own: (_apply(loaded, recording, output, own, options), own)
        )
        frame = _angles(loaded, output, mapping, options) if angles is not None else ""
        if options["residuals"] is not None:
            _residuals(loaded, recording, mapping, options)
    for text in (*notes, *filter(None, [frame])):
        note(text, quiet)
    said = "\n".join(f"wrote {path}" for path in made)
    tell(Corrected(str(output), tuple(notes)), options, said)
    return 0


def _angles(
    calibration: Calibration, corrected: Path, mapping: FieldMapping, options: dict[str, Any]
) -> str:
    """Write the angles of the corrected recording; what must be said of their frame."""
    from imucalib.calibration.angles import angles_at_rests, angles_of_samples
    from imucalib.core.angle_conventions import Conventions
    from imucalib.readers import read
    from imucalib.recording.sensors import accelerometer
    from imucalib.report.files import write_angles
    from imucalib.rests.segments import still_segments

    recording = read(corrected)
    rests = still_segments(recording)
    channel = accelerometer(recording, mapping.sensor)
    k = rests.triads.index(channel.triad)
    if options["each"] == "rest":
        angles = angles_at_rests(calibration, channel.values, rests, k)
    else:
        angles = angles_of_samples(calibration, channel.values, channel.t, rests, k)
    stated = calibration.facts.get("conventions")
    write_angles(angles, Conventions(**stated) if stated else Conventions(), options["angles"])
    if stated:
        return ""
    return "angles are in the sensor's own axes: no bench has tied them to a tool"


def _residuals(
    calibration: Calibration, source: Path, mapping: FieldMapping, options: dict[str, Any]
) -> None:
    """Write what rests read before and after."""
    from imucalib.calibration.apply import add_residuals
    from imucalib.readers import read
    from imucalib.writers.residuals import write_residuals

    recording = read(source, replace(mapping, sensor=""), strict=options["strict"])
    chosen = {name: options[name] for name in ("use", "again")}
    found = add_residuals(calibration, recording, mapping.sensor, **chosen)
    write_residuals(found, options["residuals"])


def _apply(
    calibration: Calibration,
    source: Path,
    target: Path,
    mapping: FieldMapping,
    options: dict[str, Any],
) -> tuple[str, ...]:
    """Each sensor corrected, the array fused, or both; and what there is to say of it."""
    from imucalib.calibration.apply import correct_file

    fused, at = options["fused"], options["at"]
    both = {"strict": options["strict"], "again": options["again"]}
    alone = bool(mapping.sensor) or options["use"] is not None or not calibration.triads
    words: tuple[str, ...] = ()
    if fused or at is not None or (fused is None and not alone):
        import numpy as np

        from imucalib.calibrators.array.fusion.recording import fuse_file
        from imucalib.calibrators.array.fusion.survey import NotFusable

        if fused is False or mapping.sensor:
            raise click.UsageError("--at and --fused are of all IMUs together: leave the other out")
        point = at and 1e-3 * np.array(opt.numbers_of(at, "--at", "a point: X,Y,Z in mm", {3}))
        try:
            return fuse_file(calibration, source, target, mapping, at=point, each=not fused, **both)
        except NotFusable as error:
            if fused or point is not None:
                raise
            words = (f"not fused: {error.what}",)
    notes = correct_file(calibration, source, target, mapping, use=options["use"], **both)
    return (*notes, *words)


@opt.command_with_page("convert")
@click.argument("sources", metavar="SOURCE...", nargs=-1, type=opt.PATH)
@click.argument("target", type=opt.PATH)
@opt.strict
@opt.recording
@opt.line_options
def convert(sources: tuple[Path, ...], target: Path, strict: bool, **options: Any) -> int:
    """Rewrite a recording as MCAP, HDF5 or CSV, chosen by TARGET's suffix; units become SI.

    Several SOURCEs are files of one device with clocks of one zero, each of other sensors: they
    become one recording.

    \b
    Examples:
      imucal convert log.csv log.mcap --rate 100 --acc x,y,z
      imucal convert accelerometer.csv gyroscope.csv phone.h5
    """
    from imucalib.readers import blocks, read_together
    from imucalib.writers import ChannelsChange, Noted, write_blocks, writer_for

    if not sources:
        raise click.MissingParameter(param_hint="'TARGET'", param_type="argument")
    writer_for(target)
    opt.demand_outputs(options, [target], *sources)
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
    made = Converted(str(target), tuple(noted.channels), tuple(noted.notes))
    tell(made, options, f"wrote {target}: {', '.join(noted.channels)}")
    return 0
