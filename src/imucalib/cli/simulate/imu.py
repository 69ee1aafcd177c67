"""imucal simulate imu"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.options import PagedCommand, force_option, json_option, quiet_option, seed_option
from imucalib.cli.simulate.planting import (
    demand_outputs,
    fault_option,
    plant_option,
    planted_of,
    tell,
    write_recording,
)


@click.command("imu", cls=PagedCommand, short_help="A log of one IMU turned by hand.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--rests",
    type=click.IntRange(min=2),
    default=20,
    show_default=True,
    help="Attitudes at rest, 2.5 s each, 135 deg apart.",
)
@click.option("--rate", default=100.0, show_default=True, help="Samples a second.")
@click.option("--noise", default=3.0, show_default=True, help="Noise of a sample, mg.")
@click.option("--gyro-noise", default=0.06, show_default=True, help="Noise of a rate, deg/s.")
@click.option("--late", default=0.0, show_default=True, help="The gyroscope's delay, s.")
@plant_option
@fault_option
@seed_option
@force_option
@json_option
@quiet_option
def command(recording: Path, seed: int, **options: Any) -> int:
    """Write a log of one IMU (.h5, .mcap or .csv) that is turned by hand from rest to rest.

    --plant takes the effects of a gyroscope, one value for all of its numbers or one each.

    \b
    Example:
      imucal simulate imu turns.h5 --plant gyro_g_sensitivity=0.1 --late 0.004
    """
    import numpy as np

    from imucalib.calibrators.imu.simulation import ImuPlan, simulated_imu

    demand_outputs([recording], force=options["force"])
    plant = planted_of(options["plant"])
    names = ("rests", "rate", "noise", "gyro_noise", "late")
    plan = ImuPlan(**{name: options[name] for name in names}, planted=plant)
    made, gain = simulated_imu(plan, np.random.default_rng(seed))
    write_recording(made, recording, options["fault"])
    return tell([recording], plant, options, gyro_gain=gain.tolist())
