"""imucal design"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.options import (
    PagedCommand,
    force_option,
    full_option,
    json_option,
    pairs,
    quiet_option,
)
from imucalib.cli.output import note, present, working


def plan_for(path: Path, options: dict[str, Any]) -> int:
    """Print the plan of a calibration, and write its table where asked; the exit code."""
    from imucalib.atomic_file import demand_output
    from imucalib.calibration.checking.noise import size_of
    from imucalib.calibrators.next_recording import next_recording
    from imucalib.report.design import separation_dict, separation_document

    if options["output"] is not None:
        demand_output(options["output"], [path], force=options["force"])
    size = options["between_sessions"]
    between = 0.0 if size is None else size_of(size, ("mg",))[0]
    with working("planning", quiet=options["quiet"]):
        found = next_recording(path, _temperatures(options["temperatures"]), between)
    if options["output"] is not None and found.table:
        write_table(found.table, options["output"], [path], options)
    present(separation_document(found, path.name), separation_dict(found), options)
    return found.exit_code


def _temperatures(text: str | None) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != 2 or not -100.0 < found[0] < found[1] < 200.0:
        raise click.BadParameter(
            f"'{text}' is not of the form LOW,HIGH in degC", param_hint="--temperatures"
        )
    return found


def write_table(text: str, path: Path, read: list[Path], options: dict[str, Any]) -> None:
    """A table as text, whole or not at all, over another's file only with --force."""
    from imucalib.atomic_file import demand_output, replaced_atomically

    demand_output(path, read, force=options["force"])
    with replaced_atomically(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    note(f"wrote {path}", options["quiet"])


def by_hand(calibration: Path | None, rests: int | None, options: dict[str, Any]) -> int:
    """Print a plan of turns, or what to add to those of a calibration; the exit code."""
    from imucalib.calibration.file import read
    from imucalib.calibrators.imu.plan import hand_plan, turns_to_add
    from imucalib.report.imu import hand_plan_dict, hand_plan_document

    for name in ("separate", "output", "temperatures", "between_sessions"):
        if options[name] is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} does not go with --imu")
    plan = hand_plan(rests or 0) if calibration is None else turns_to_add(read(calibration))
    present(hand_plan_document(plan), hand_plan_dict(plan), options)
    return 4 if plan.open_gains else 0


@click.command("design", cls=PagedCommand, short_help="Judge a set of positions.")
@click.argument("table", type=click.Path(path_type=Path), required=False)
@click.option(
    "--recommend",
    "count",
    type=click.IntRange(min=4),
    help="Instead of TABLE: a good set of N positions.",
)
@click.option(
    "--columns",
    multiple=True,
    metavar="ROLE=NAME,...",
    help="Columns by heading: inclination, tool_face.",
)
@click.option(
    "--convention",
    default="paper",
    show_default=True,
    help="Angles: paper, drilling-gravity or drilling-force.",
)
@click.option(
    "--separate",
    type=click.Path(path_type=Path),
    metavar="CAL",
    help="Instead of TABLE: what to record next so that a calibration's rivals are told apart.",
)
@click.option(
    "--imu",
    is_flag=True,
    help="Turns of one IMU by hand: a plan for N rests with --recommend, or with the "
    "calibration of `imucal imu` as TABLE what to add to its log.",
)
@click.option(
    "--temperatures",
    metavar="LOW,HIGH",
    help="With --separate: temperatures that can be held, degC; default: as recorded.",
)
@click.option(
    "--between-sessions",
    metavar="SIZE",
    help="With --separate: the recording comes after another power-up, between which the "
    "bias scatters by this, for example 0.5mg.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the positions as a table (CSV) for `design` and `lab`.",
)
@force_option
@full_option
@json_option
@quiet_option
def command(
    table: Path | None,
    count: int | None,
    columns: tuple[str, ...],
    convention: str,
    **options: Any,
) -> int:
    """How good is a set of positions, and which one or two more would help most.

    Or what to record next so that an ambiguity ends: exit 0 where the plan ends it or there is
    none, 5 where it cannot. Or, with --imu, which turns to take by hand.

    \b
    Examples:
      imucal design positions.csv
      imucal design --recommend 24 -o plan.csv
      imucal design --separate out/calibration.yaml -o plan.csv
      imucal design --imu --recommend 20
      imucal design --imu out/calibration.yaml
    """
    from imucalib.calibrators.lab.conventions import preset
    from imucalib.calibrators.lab.design import design_of, recommend
    from imucalib.calibrators.lab.position_table import read_position_table
    from imucalib.report.design import design_dict, design_document

    separate, output = options["separate"], options["output"]
    if sum(given is not None for given in (table, count, separate)) != 1:
        raise click.UsageError("give one of TABLE, --recommend N and --separate CAL")
    if options["imu"]:
        return by_hand(table, count, options)
    if separate is not None:
        return plan_for(separate, options)
    for name in ("temperatures", "between_sessions"):
        if options[name] is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} goes with --separate")
    angles = preset(convention)
    if table is not None:
        positions = read_position_table(table, pairs(columns, "--columns"), need_raw=False)
        plan = design_of(positions.columns["inclination"], positions.columns["tool_face"], angles)
    else:
        plan = design_of(*angles.outside(*recommend(count or 0)), angles)
    if output is not None:
        rows = zip(plan.inclination.tolist(), plan.tool_face.tolist(), strict=True)
        text = "".join(f"{i:.1f},{t:.1f}\n" for i, t in rows)
        write_table(f"inclination,tool_face\n{text}", output, [table] if table else [], options)
    present(design_document(plan, answer=table is None), design_dict(plan), options)
    return 4 if plan.vector.open_directions else 0
