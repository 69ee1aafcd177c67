"""imucal design"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imucalib.cli.output import (
    color,
    emit_json,
    full_option,
    json_option,
    note,
    pairs,
    quiet_option,
    width,
)
from imucalib.cli.recording_options import force_option

if TYPE_CHECKING:
    from imucalib.calibrators.lab.design import Plan


@click.command("design", short_help="Judge a set of positions.")
@click.argument("table", type=click.Path(path_type=Path), required=False)
@click.option(
    "--recommend",
    "count",
    type=click.IntRange(min=4),
    help="Instead of TABLE: a good set of N positions.",
)
@click.option(
    "--axes",
    type=click.Choice(["1", "2"]),
    default="2",
    show_default=True,
    help="Axes of the table, with --recommend.",
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
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False),
              help="Write the positions as a table (CSV) for `design` and `lab`.")  # fmt: skip
@force_option
@full_option
@json_option
@quiet_option
def command(
    table: Path | None,
    count: int | None,
    axes: str,
    columns: tuple[str, ...],
    convention: str,
    output: Path | None,
    force: bool,
    full: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """How good is a set of positions, and which one or two more would help most.

    \b
    Examples:
      imucal design positions.csv
      imucal design --recommend 24 -o plan.csv
    """
    from imucalib.calibrators.lab.conventions import preset
    from imucalib.calibrators.lab.design import design_of, recommended
    from imucalib.calibrators.lab.position_table import read_position_table
    from imucalib.report.design import design_dict, design_document
    from imucalib.report.render.text import render_text

    if (table is None) == (count is None):
        raise click.UsageError("give either TABLE or --recommend N")
    angles = preset(convention)
    if table is not None:
        positions = read_position_table(table, pairs(columns, "--columns"), need_raw=False)
        plan = design_of(positions.columns["inclination"], positions.columns["tool_face"], angles)
    else:
        plan = recommended(count or 0, int(axes), angles)
    if output is not None:
        _write(plan, output, [table] if table else [], force)
        note(f"wrote {output}", quiet)
    if as_json:
        emit_json(design_dict(plan))
    elif not quiet:
        document = design_document(plan, asked=table is None)
        click.echo(render_text(document, width(), color=color(), full=full), nl=False)
    return 4 if plan.vector.open_directions else 0


def _write(plan: Plan, path: Path, read: list[Path], force: bool) -> None:
    """The positions, degrees in the plan's conventions."""
    from imucalib.atomic_file import demand_output, replaced_atomically

    demand_output(path, read, force=force)
    rows = zip(plan.inclination.tolist(), plan.tool_face.tolist(), strict=True)
    text = "".join(f"{i:.1f},{t:.1f}\n" for i, t in rows)
    with replaced_atomically(path) as temporary:
        temporary.write_text(f"inclination,tool_face\n{text}", encoding="utf-8")
