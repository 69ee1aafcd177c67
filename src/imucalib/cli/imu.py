"""imucal imu: Calibrate one IMU, accelerometer and gyroscope, from rests and turns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import calibrating, limit_option, shared_fields
from imucalib.cli.frame.output import Say

if TYPE_CHECKING:
    from imucalib.recording.mapping import FieldMapping
    from imucalib.report.files import Report


@opt.command_with_page("imu")
@click.argument("recordings", metavar="RECORDING...", nargs=-1, required=True, type=opt.PATH)
@opt.option(
    "--gyro-axes",
    "Rates that are the gyroscope's x, y, z, for example -y,x,z.",
    default="",
    metavar="X,Y,Z",
)
@limit_option("--max-force-error", "held-out error of |a|, mg rms.")
@opt.shortest_rest
@calibrating
def command(recordings: tuple[Path, ...], say: Say, **options: Any) -> list[Report]:
    """Calibrate accelerometer and gyroscope of one IMU from rests and the turns between them.

    RECORDING is a log in which the IMU rests for two seconds in ten attitudes or more and is turned
    by hand from each to the next. Gravity at the rests calibrates the accelerometer, and how the
    rate carries it over the turns the gyroscope. Writes calibration.yaml, report.html and
    report.json into the folder given by -o, and prints the report. Of several IMUs in it, --sensor
    names one, or all: then each has a folder of its own.

    \b
    Examples:
      imucal imu turns.csv -o out
      imucal imu flight.ulg -o out --sensor all
      imucal imu log.mcap -o out --latitude 59.3 --export kalibr
    """
    from imucalib.calibrators.imu.request import ImuRequest
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.recording.mapping import parse_axis_map
    from imucalib.report.files import Report
    from imucalib.report.imu import compose_imu_document

    axes = parse_axis_map(options["gyro_axes"])
    request = ImuRequest(**shared_fields(options), gyro_axes=axes, still=opt.still_of(options))
    mapping, reports = opt.mapping_of(options), []
    for sensor in _list_sensors(recordings[0], mapping):
        run = run_imu(recordings, replace(mapping, sensor=sensor), request, say)
        reports.append(Report(run, compose_imu_document(run), sensor))
    return reports


def _list_sensors(recording: Path, mapping: FieldMapping) -> tuple[str, ...]:
    """The sensor that is named, or every one of the recording."""
    from imucalib.readers import blocks
    from imucalib.recording.sensors import ALL, accelerometers

    if mapping.sensor != ALL:
        return (mapping.sensor,)
    found = blocks(recording, replace(mapping, sensor=""))
    return tuple(dict.fromkeys(name for block in found for name in accelerometers(block)))
