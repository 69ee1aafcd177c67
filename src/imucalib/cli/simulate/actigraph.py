"""imucal simulate actigraph"""

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


@click.command("actigraph", cls=PagedCommand, short_help="Days on a wrist.")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--days", default=1.0, show_default=True, help="Length of the recording.")
@click.option("--rate", default=10.0, show_default=True, help="Samples a second.")
@click.option("--rests", default=0.6, show_default=True, help="Share of the time at rest.")
@click.option("--noise", default=4.0, show_default=True, help="Noise of a sample, mg.")
@click.option(
    "--temperature/--no-temperature",
    default=True,
    show_default=True,
    help="Whether a thermometer records.",
)
@plant_option
@fault_option
@seed_option
@force_option
@json_option
@quiet_option
def command(recording: Path, seed: int, **options: Any) -> int:
    """Write days on a wrist (.h5, .csv or .mcap): postures at rest, movement, a thermometer.

    \b
    Example: imucal simulate actigraph day.h5 --plant temperature_bias=0.2,0,-0.1
    """
    from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks
    from imucalib.errors import UsageError
    from imucalib.readers.joining import join

    if not (options["days"] > 0.0 and options["rate"] > 0.0):
        raise UsageError("--days and --rate are positive")
    demand_outputs([recording], force=options["force"])
    plant = planted_of(options["plant"])
    plan = WeekPlan(
        days=options["days"],
        rests=options["rests"],
        noise=options["noise"],
        rate=options["rate"],
        plant=plant,
        temperature=options["temperature"],
    )
    with working("simulating", quiet=options["quiet"]):
        write_recording(join(worn_blocks(plan, seed), "simulated"), recording, options["fault"])
    return tell([recording], plant, options, sensor={k: list(v) for k, v in plan.sensor.items()})
