"""imucal imu"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli import options as opt
from imucalib.cli.calibrating import calibrating, calibrating_of, finish, limit_option, shared_of


@opt.paged("imu")
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
    from imucalib.calibrators.imu.request import ImuRequest
    from imucalib.calibrators.imu.run import run_imu
    from imucalib.recording.mapping import parse_axis_map
    from imucalib.report.files import Report
    from imucalib.report.imu import imu_document

    axes = parse_axis_map(options["gyro_axes"])
    request = ImuRequest(**shared_of(options), gyro_axes=axes, still=opt.still_of(options))
    with calibrating_of(options) as say:
        run = run_imu(recordings, opt.mapping_of(options), request, say)
    return finish([Report(run, imu_document(run))], options)
