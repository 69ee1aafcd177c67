"""imucal design: Judge a set of positions, and say which added ones help most."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import note, present, working


@opt.command_with_page("design")
@click.argument("table", type=opt.PATH, required=False)
@opt.option(
    "--recommend count", "Instead of TABLE: a good set of N positions.", type=click.IntRange(min=4)
)
@opt.many("--columns", "ROLE=NAME,...", "Columns by heading: inclination, tool_face.")
@opt.convention
@opt.path(
    "--separate",
    "Instead of TABLE: what to record next so that a calibration's rivals are told apart.",
    metavar="CAL",
)
@opt.flag(
    "--imu",
    "Turns of one IMU by hand: a plan for N rests with --recommend, or with the "
    "calibration of `imucal imu` as TABLE what to add to its log.",
)
@opt.option(
    "--temperatures",
    "With --separate: temperatures that can be held, degC; default: as recorded.",
    metavar="LOW,HIGH",
)
@opt.option(
    "--between-sessions",
    "With --separate: the recording comes after another power-up, between which the "
    "bias scatters by this, for example 0.5mg.",
    metavar="SIZE",
)
@opt.file("-o --output", "Write the positions as a table (CSV) for `design` and `lab`.")
@opt.page_options
def command(table: Path | None, count: int | None, **options: Any) -> int:
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
    separate, of_separate = options["separate"], ("temperatures", "between_sessions")
    if sum(given is not None for given in (table, count, separate)) != 1:
        raise click.UsageError("give one of TABLE, --recommend N and --separate CAL")
    if options["imu"]:
        _refuse(options, "does not go with --imu", "separate", "output", *of_separate)
        return _turns(table, count, options)
    if separate is not None:
        return _separation(separate, options)
    _refuse(options, "goes with --separate", *of_separate)
    return _positions(table, count, options)


def _positions(table: Path | None, count: int | None, options: dict[str, Any]) -> int:
    """Judge a set of positions, or recommend so many; the exit code."""
    from imucalib.calibrators.lab.design import design_of, recommend
    from imucalib.calibrators.lab.position_table import read_position_table
    from imucalib.core.angle_conventions import preset
    from imucalib.report.design import compose_design_document, design_dict

    angles = preset(options["convention"])
    if table is not None:
        positions = read_position_table(
            table, opt.pairs(options["columns"], "--columns"), need_raw=False
        )
        plan = design_of(positions.columns["inclination"], positions.columns["tool_face"], angles)
    else:
        plan = design_of(*angles.outside(*recommend(count or 0)), angles)
    rows = zip(plan.inclination.tolist(), plan.tool_face.tolist(), strict=True)
    text = "".join(f"{i:.1f},{t:.1f}\n" for i, t in rows)
    _write_table(f"inclination,tool_face\n{text}", [table] if table else [], options)
    present(compose_design_document(plan, answer=table is None), design_dict(plan), options)
    return 4 if plan.vector.open_directions else 0


def _separation(path: Path, options: dict[str, Any]) -> int:
    """What to record next beside a calibration; the exit code."""
    from imucalib.calibration.checking.noise import size_of
    from imucalib.calibrators.next_recording import next_recording
    from imucalib.report.design import compose_separation_document, separation_dict

    opt.demand_outputs(options, [options["output"]], path)
    size = options["between_sessions"]
    between = 0.0 if size is None else size_of(size, ("mg",))[0]
    held = options["temperatures"]
    if held is not None:
        held = opt.numbers_of(held, "--temperatures", "of the form LOW,HIGH in degC", {2}, -100.0)
    with working("planning", quiet=options["quiet"]):
        found = next_recording(path, held or (), between)
    _write_table(found.table, [path], options)
    present(compose_separation_document(found, path.name), separation_dict(found), options)
    return found.exit_code


def _turns(calibration: Path | None, rests: int | None, options: dict[str, Any]) -> int:
    """A plan of turns by hand, or what to add to those of a calibration; the exit code."""
    from imucalib.calibration.file import read
    from imucalib.calibrators.imu.plan import hand_plan, turns_to_add
    from imucalib.report.imu import compose_hand_plan_document, describe_hand_plan

    plan = hand_plan(rests or 0) if calibration is None else turns_to_add(read(calibration))
    present(compose_hand_plan_document(plan), describe_hand_plan(plan), options)
    return 4 if plan.open_gains else 0


def _refuse(options: dict[str, Any], why: str, *names: str) -> None:
    """Refuse options of another use of the command."""
    for name in names:
        if options[name] is not None:
            raise click.UsageError(f"--{name.replace('_', '-')} {why}")


def _write_table(text: str, read: list[Path], options: dict[str, Any]) -> None:
    """The table that was asked for, whole or not at all, over another's only with --force."""
    from imucalib.calibration.file import write_whole

    path = options["output"]
    if path is None or not text:
        return
    opt.demand_outputs(options, [path], *read)
    write_whole(path, text)
    note(f"wrote {path}", options["quiet"])
