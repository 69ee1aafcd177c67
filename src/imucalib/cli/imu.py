"""imucal imu"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.calibrating import (
    calibrating,
    calibrating_of,
    finish,
    limit_option,
    shared_of,
)
from imucalib.cli.options import PagedCommand, mapping_of, shortest_rest_option, still_of

if TYPE_CHECKING:
    from imucalib.calibrators.imu.request import ImuRequest


@click.command("imu", cls=PagedCommand, short_help="Calibrate one IMU from rests and turns.")
@click.argument(
    "recordings", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path)
)
@click.option(
    "--gyro-axes",
    default="",
    metavar="X,Y,Z",
    help="Rates that are the gyroscope's x, y, z, for example -y,x,z.",
)
@limit_option("--max-force-error", "held-out error of |a|, mg rms.")
@shortest_rest_option
@calibrating
def command(recordings: tuple[Path, ...], **options: Any) -> int:
    """Calibrate accelerometer and gyroscope of one IMU from rests and the turns between them.

    RECORDING is a log in which the IMU rests for two seconds in ten attitudes or more and is turned
    by hand from each to the next. Gravity at the rests calibrates the accelerometer, and how the
    rate carries it over the turns the gyroscope. Writes calibration.yaml, report.html and
    report.json into the folder given by -o, and prints the report.

    \b
    Examples:
      imucal imu turns.csv -o out
      imucal imu log.mcap -o out --latitude 59.3 --export kalibr
    """
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.report.files import Report
    from imucalib.report.imu import imu_document

    request, mapping = request_of(options), mapping_of(options)
    with calibrating_of(options) as say:
        run = run_imu(recordings, mapping, request, say)
    return finish([Report(run, imu_document(run))], options)


def request_of(options: dict[str, Any]) -> ImuRequest:
    """The request that the options state; raises click's usage errors."""
    from imucalib.calibrators.imu.request import ImuRequest
    from imucalib.recording.mapping import parse_axis_map

    shared = shared_of(options)
    return ImuRequest(
        gravity=shared.gravity,
        gravity_source=shared.gravity_source,
        declare=shared.declare,
        only=shared.only,
        without=shared.without,
        loop=shared.loop,
        curves=ImuRequest.curves if shared.curves is None else shared.curves,
        extra_effects=shared.extra_effects,
        gyro_axes=parse_axis_map(options["gyro_axes"]),
        still=still_of(options),
        limits=shared.limits,
        seed=shared.seed,
        command=shared.command,
    )
