"""imucal simulate: Make a table or recording with planted effects and faults."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import tell, working
from imucalib.data import Data

if TYPE_CHECKING:
    from imucalib.recording.recording import Recording

_RECORDING = click.argument("recording", type=opt.PATH)
_PLANT = opt.many("--plant", "EFFECT=VALUE,...", "Effect to plant, in its own units.")
_FAULT = opt.many(
    "--fault",
    "FAULT",
    "gap@START:LENGTH, freeze@START:LENGTH (s), sign@SENSOR:AXIS, clip@G, exchange@SENSOR:SENSOR.",
)
_LAST = opt.combine([opt.seed, opt.line_options])
_RATE = opt.option("--rate", "Samples a second.", default=100.0)


@click.group("simulate")
def command() -> None:
    """Make a table or a recording with planted effects, faults and noise, for any calibrator.

    What was planted is printed (--json for machines), and stands in no file: a calibrator must
    find it.

    \b
    Examples:
      imucal simulate lab bench.csv --plant inclination_zero=0.8 --slip 10:y
      imucal simulate actigraph day.h5 --plant quadratic=3,-3,4
      imucal simulate array log.h5 --plant gyro_delay=0.001 --fault gap@20:2
    """


@opt.command_with_page("actigraph", short_help="Days on a wrist.")
@_RECORDING
@opt.option("--days", "Length of the recording.", default=1.0)
@opt.option("--rate", "Samples a second.", default=10.0)
@opt.option("--rests", "Share of the time at rest.", default=0.6)
@opt.option("--noise", "Noise of a sample, mg.", default=4.0)
@opt.option("--temperature/--no-temperature", "Whether a thermometer records.", default=True)
@_PLANT
@_FAULT
@_LAST
def actigraph(recording: Path, seed: int, **options: Any) -> int:
    """Write days on a wrist (.h5, .csv or .mcap): postures at rest, movement, a thermometer.

    \b
    Example: imucal simulate actigraph day.h5 --plant temperature_bias=0.2,0,-0.1
    """
    from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks
    from imucalib.errors import UsageError
    from imucalib.readers.fields.joining import join

    if not (options["days"] > 0.0 and options["rate"] > 0.0):
        raise UsageError("--days and --rate are positive")
    _demand_outputs(options, [recording])
    plant = _parse_planted(options["plant"])
    names = ("days", "rests", "noise", "rate", "temperature")
    plan = WeekPlan(**{name: options[name] for name in names}, plant=plant)
    with working("simulating", quiet=options["quiet"]):
        _write(join(worn_blocks(plan, seed), "simulated"), recording, options["fault"])
    return _finish([recording], plant, options, sensor=plan.sensor)


@opt.command_with_page("array", short_help="A board's bench log.")
@_RECORDING
@opt.option("--board", "Board file (YAML), or a name.", default="mimu4444_corners")
@opt.option("--rests", "Attitudes at rest, 5 s each.", default=20)
@opt.option("--seconds", "Length of the motion.", default=60.0)
@_RATE
@opt.option("--twist", "Of each axis, deg/s rms.", default=700.0)
@opt.option("--noise", "Noise of a sample, mg.", default=4.0)
@opt.option("--gyro-noise", "Noise of a rate, deg/s.", default=0.2)
@opt.option("--scatter", "Of the true places about the drawing, mm.", default=0.2)
@_PLANT
@_FAULT
@_LAST
def array(recording: Path, seed: int, **options: Any) -> int:
    """Write a bench log of a board (.h5, .mcap or .csv): rests, then twisting by hand.

    --plant takes gyro_scale (1), gyro_delay (s) and quadratic (1 per m/s²), one value each.

    \b
    Example:
      imucal simulate array log.h5 --plant gyro_delay=0.001 --fault sign@imu3:y
    """
    import numpy as np

    from imucalib.calibrators.array.board.board import read_board
    from imucalib.calibrators.array.simulation import LogPlan, simulate_log
    from imucalib.errors import UsageError
    from imucalib.units import MG

    _demand_outputs(options, [recording], Path(options["board"]))
    plant = _parse_planted(options["plant"])
    if any(len(values) != 1 for values in plant.values()):
        raise UsageError("--plant of an array takes one value each")
    plan = LogPlan(
        poses=options["rests"],
        **{name: options[name] for name in ("seconds", "rate", "twist")},
        sigma=options["noise"] * MG,
        sigma_gyro=options["gyro_noise"],
        scatter=1e-3 * options["scatter"],
        planted={name: values[0] for name, values in plant.items()},
    )
    board = read_board(options["board"])
    with working("simulating", quiet=options["quiet"]):
        made = simulate_log(board, plan, np.random.default_rng(seed))
        _write(made.recording, recording, options["fault"])
    return _finish([recording], plant, options, positions_mm=(1e3 * made.positions).tolist())


@opt.command_with_page("imu", short_help="A log of one IMU turned by hand.")
@_RECORDING
@opt.option(
    "--rests",
    "Attitudes at rest, 2.5 s each, 135 deg apart.",
    type=click.IntRange(min=2),
    default=20,
)
@_RATE
@opt.option("--noise", "Noise of a sample, mg.", default=3.0)
@opt.option("--gyro-noise", "Noise of a rate, deg/s.", default=0.06)
@opt.option("--late", "The gyroscope's delay, s.", default=0.0)
@_PLANT
@_FAULT
@_LAST
def imu(recording: Path, seed: int, **options: Any) -> int:
    """Write a log of one IMU (.h5, .mcap or .csv) that is turned by hand from rest to rest.

    --plant takes the effects of a gyroscope, one value for all of its numbers or one each.

    \b
    Example:
      imucal simulate imu turns.h5 --plant gyro_g_sensitivity=0.1 --late 0.004
    """
    import numpy as np

    from imucalib.calibrators.imu.simulation import ImuPlan, simulate_imu

    _demand_outputs(options, [recording])
    plant = _parse_planted(options["plant"])
    names = ("rests", "rate", "noise", "gyro_noise", "late")
    plan = ImuPlan(**{name: options[name] for name in names}, planted=plant)
    made, gain = simulate_imu(plan, np.random.default_rng(seed))
    _write(made, recording, options["fault"])
    return _finish([recording], plant, options, gyro_gain=gain.tolist())


@opt.command_with_page("lab", short_help="A bench: a table, and a recording on request.")
@click.argument("table", type=opt.PATH)
@opt.path(
    "--recording",
    "Also a recording that rests in every position: .mcap, .h5 or .csv; "
    "TABLE then holds angles only.",
)
@opt.choice("--layout", "sweeps rings random", "How the bench is worked.", default="sweeps")
@opt.option("--positions", "Number of positions.", default=32)
@_PLANT
@opt.many("--slip", "ROW:AXIS", "Lose the sign of one cell.")
@opt.option("--noise", "Noise of a reading, mg.", default=1.0)
@opt.option(
    "--setting-sd", "Scatter of the settings, deg: inclination,tool-face.", default="0.1,0.2"
)
@opt.option("--temperature", "FROM,TO in °C: warms up over the table.")
@opt.option("--gravity", "Local gravity, m/s².", default=9.80665)
@_FAULT
@_LAST
def lab(table: Path, recording: Path | None, seed: int, **options: Any) -> int:
    """Write a bench table (CSV), and on request a recording, with known planted effects.

    \b
    Example:
      imucal simulate lab bench.csv --plant inclination_zero=0.8 --slip 10:y
    """
    import numpy as np

    from imucalib.calibrators.lab.position_table import write_position_table
    from imucalib.calibrators.lab.simulation import BenchPlan, simulate_recording, simulate_table
    from imucalib.errors import UsageError

    if options["fault"] and recording is None:
        raise UsageError("--fault is of a recording", remedy="give --recording, or --slip")
    written = [table, *filter(None, [recording])]
    _demand_outputs(options, written)
    warming = options["temperature"]
    plan = BenchPlan(
        **{name: options[name] for name in ("layout", "positions", "noise", "gravity")},
        plant=_parse_planted(options["plant"]),
        setting=_two_of(options["setting_sd"], "--setting-sd"),
        slips=tuple((int(r), a) for r, _, a in (s.partition(":") for s in options["slip"])),
        temperature=_two_of(warming, "--temperature") if warming else None,
    )
    rng = np.random.default_rng(seed)
    made = simulate_table(plan, rng)
    if recording is not None:
        _write(simulate_recording(made, rng), recording, options["fault"])
    write_position_table(made, table, angles_only=recording is not None)
    return _finish(written, plan.plant, options)


for one in (actigraph, array, imu, lab):
    command.add_command(one)


def _two_of(text: str, option: str) -> tuple[float, float]:
    a, b = opt.numbers_of(text, option, "two numbers", {2})
    return a, b


def _parse_planted(texts: Sequence[str]) -> dict[str, tuple[float, ...]]:
    """ "bias=1,2,3" by name; raises click's usage error."""
    each = (text.partition("=") for text in texts)
    form, counts = "the numbers of EFFECT=VALUE,...", range(1, 1000)
    return {name: opt.numbers_of(v, "--plant", form, counts) for name, _, v in each}


def _demand_outputs(options: Mapping[str, Any], paths: Sequence[Path], *read: Path) -> None:
    """Raise UsageError unless a simulation may write to each of the paths, two at the most."""
    from imucalib.errors import UsageError

    if len({path.absolute() for path in paths}) < len(paths):
        raise UsageError("the table and the recording are one file", where=str(paths[0]))
    opt.demand_outputs(options, paths, *read)


def _write(made: Recording, path: Path, faults: Sequence[str]) -> None:
    """Write a recording as the faults leave it."""
    from imucalib.calibrators.planted import fault_of, with_faults
    from imucalib.writers import write

    write(with_faults(made, [fault_of(text) for text in faults]), path)


class Simulated(Data, name="simulation/1"):
    """What was simulated, and the truth of it."""

    written: tuple[str, ...]
    planted: Annotated[Mapping[str, tuple[float, ...]], "Parameters of effects by their names."]
    faults: tuple[str, ...] | None = None
    sensor: Annotated[Mapping[str, tuple[float, ...]] | None, "Of a worn one."] = None
    positions_mm: Annotated[list[list[float]] | None, "Of the IMUs of an array."] = None
    gyro_gain: Annotated[list[list[float]] | None, "Of one IMU."] = None


def _finish(
    written: Sequence[Path],
    plant: Mapping[str, tuple[float, ...]],
    options: Mapping[str, Any],
    **truth: Any,
) -> int:
    """Say what was written and planted, to people or machines; returns the exit code."""
    faults = tuple(options["fault"]) or None
    made = Simulated(tuple(map(str, written)), plant, faults, **truth)
    tell(made, options, "\n".join(f"wrote {path}" for path in written))
    return 0
