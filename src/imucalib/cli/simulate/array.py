"""imucal simulate array"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.options import PagedCommand, force_option, json_option, quiet_option, seed_option
from imucalib.cli.output import working
from imucalib.cli.simulate.planting import (
    demand_outputs,
    fault_option,
    plant_option,
    planted_of,
    tell,
    write_recording,
)


@click.command("array", cls=PagedCommand, short_help="A board's bench log.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--board", default="mimu4444_corners", show_default=True, help="Board file (YAML), or a name."
)
@click.option("--rests", default=20, show_default=True, help="Attitudes at rest, 5 s each.")
@click.option("--seconds", default=60.0, show_default=True, help="Length of the motion.")
@click.option("--rate", default=100.0, show_default=True, help="Samples a second.")
@click.option("--twist", default=700.0, show_default=True, help="Of each axis, deg/s rms.")
@click.option("--noise", default=4.0, show_default=True, help="Noise of a sample, mg.")
@click.option("--gyro-noise", default=0.2, show_default=True, help="Noise of a rate, deg/s.")
@click.option(
    "--scatter", default=0.2, show_default=True, help="Of the true places about the drawing, mm."
)
@plant_option
@fault_option
@seed_option
@force_option
@json_option
@quiet_option
def command(recording: Path, seed: int, **options: Any) -> int:
    """Write a bench log of a board (.h5, .mcap or .csv): rests, then twisting by hand.

    --plant takes gyro_scale (1), gyro_delay (s) and quadratic (1 per m/s²), one value each.

    \b
    Example:
      imucal simulate array log.h5 --plant gyro_delay=0.001 --fault sign@imu3:y
    """
    import numpy as np

    from imucalib.calibrators.array.board import read_board
    from imucalib.calibrators.array.simulation import LogPlan, simulated_log
    from imucalib.errors import UsageError
    from imucalib.units import MG

    demand_outputs([recording], [Path(options["board"])], force=options["force"])
    plant = planted_of(options["plant"])
    if any(len(values) != 1 for values in plant.values()):
        raise UsageError("--plant of an array takes one value each")
    plan = LogPlan(
        poses=options["rests"],
        seconds=options["seconds"],
        rate=options["rate"],
        twist=options["twist"],
        sigma=options["noise"] * MG,
        sigma_gyro=options["gyro_noise"],
        scatter=1e-3 * options["scatter"],
        planted={name: values[0] for name, values in plant.items()},
    )
    board = read_board(options["board"])
    with working("simulating", quiet=options["quiet"]):
        made = simulated_log(board, plan, np.random.default_rng(seed))
        write_recording(made.recording, recording, options["fault"])
    return tell([recording], plant, options, positions_mm=(1e3 * made.positions).tolist())
