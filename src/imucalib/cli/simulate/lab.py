"""imucal simulate lab"""

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


def _two(text: str, option: str) -> tuple[float, float]:
    try:
        a, b = (float(v) for v in text.split(","))
    except ValueError:
        raise click.BadParameter(f"'{text}' is not two numbers", param_hint=option) from None
    return a, b


@click.command("lab", cls=PagedCommand, short_help="A bench: a table, and a recording on request.")
@click.argument("table", type=click.Path(path_type=Path))
@click.option(
    "--recording",
    type=click.Path(path_type=Path),
    help="Also a recording that rests in every position: .mcap, .h5 or .csv; "
    "TABLE then holds angles only.",
)
@click.option(
    "--layout",
    type=click.Choice(["sweeps", "rings", "random"]),
    default="sweeps",
    show_default=True,
    help="How the bench is worked.",
)
@click.option("--positions", default=32, show_default=True, help="Number of positions.")
@plant_option
@click.option("--slip", multiple=True, metavar="ROW:AXIS", help="Lose the sign of one cell.")
@click.option("--noise", default=1.0, show_default=True, help="Noise of a reading, mg.")
@click.option(
    "--setting-sd",
    default="0.1,0.2",
    show_default=True,
    help="Scatter of the settings, deg: inclination,tool-face.",
)
@click.option("--temperature", help="FROM,TO in °C: warms up over the table.")
@click.option("--gravity", default=9.80665, show_default=True, help="Local gravity, m/s².")
@fault_option
@seed_option
@force_option
@json_option
@quiet_option
def command(table: Path, recording: Path | None, seed: int, **options: Any) -> int:
    """Write a bench table (CSV), and on request a recording, with known planted effects.

    \b
    Example:
      imucal simulate lab bench.csv --plant inclination_zero=0.8 --slip 10:y
    """
    import numpy as np

    from imucalib.calibrators.lab.position_table import write_position_table
    from imucalib.calibrators.lab.simulation import BenchPlan, simulated_recording, simulated_table
    from imucalib.errors import UsageError

    if options["fault"] and recording is None:
        raise UsageError("--fault is of a recording", remedy="give --recording, or --slip")
    demand_outputs([table, *filter(None, [recording])], force=options["force"])
    slips = tuple((int(r), a) for r, _, a in (s.partition(":") for s in options["slip"]))
    plan = BenchPlan(
        layout=options["layout"],
        positions=options["positions"],
        plant=planted_of(options["plant"]),
        noise=options["noise"],
        setting=_two(options["setting_sd"], "--setting-sd"),
        slips=slips,
        gravity=options["gravity"],
        temperature=_two(options["temperature"], "--temperature")
        if options["temperature"]
        else None,
    )
    rng = np.random.default_rng(seed)
    made = simulated_table(plan, rng)
    written = [table]
    if recording is not None:
        write_recording(simulated_recording(made, rng), recording, options["fault"])
        written.append(recording)
    write_position_table(made, table, angles_only=recording is not None)
    return tell(written, plan.plant, options)
