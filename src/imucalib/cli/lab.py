"""imucal lab: Calibrate a tool's accelerometer on a bench of known angles, or by gravity alone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.calibrating import calibrating, limit_option, shared_fields
from imucalib.cli.frame.output import Say, freed_memory

if TYPE_CHECKING:
    from imucalib.calibrators.lab.request import LabRequest
    from imucalib.report.files import Report

#: Bytes: a search takes the same few arrays again and again, and of hundreds of rows a quarter of
#: its time went into pages that the system clears anew for each.
_KEPT = 1 << 29
_CONVENTIONS = (
    "gravity_sign",
    "z_axis",
    "inclination_zero",
    "toolface_zero_axis",
    "toolface_sense",
    "toolface_offset",
)


@opt.command_with_page("lab")
@click.argument("tables", metavar="TABLE...", nargs=-1, required=True, type=opt.PATH)
@opt.path(
    "--recording",
    "Recording with the positions of TABLE in order; its still segments are averaged.",
)
@opt.choice(
    "--reference",
    "vector direction norm",
    "Known angles; directions without dials (a column face with +x ... -z, or ux, uy, "
    "uz); or only the size of gravity (TABLE may then be a recording).",
    default="vector",
)
@opt.many(
    "--columns",
    "ROLE=NAME,...",
    "By heading: inclination, tool_face, face, x, y, z, temperature, samples, driver.",
)
@opt.convention
@opt.choice("--gravity-sign", "down up", "Which way an axis points that reads +g.")
@opt.choice("--z-axis", "down-hole up-hole", "The tool's end to which z points.")
@opt.choice("--inclination-zero", "horizontal vertical", "What inclination 0 means.")
@opt.choice("--toolface-zero-axis", "+x -x +y -y", "Axis that reads most at tool-face 0.")
@opt.choice("--toolface-sense", "clockwise counter-clockwise", "Clockwise: from +y towards +x.")
@opt.option("--toolface-offset", "Degrees added to every tool-face.", type=float)
@opt.option("--model", "linear12 or geometric9.", default="linear12")
@opt.choice(
    "--objective",
    "settings vector angles paper",
    "What is minimised; settings: angles are uncertain as set.",
    default="settings",
)
@opt.fleet
@opt.flag("--as-published", "The paper's own method, as it was published.")
@opt.option(
    "--train",
    "Rows to choose and fit on, for example 1-20; the rest tests.",
    default="",
    metavar="ROWS",
)
@opt.option(
    "--trust",
    "Where a tool slipped: rows that stand right.",
    default="",
    metavar="ROWS",
)
@opt.option("--exclude", "Leave rows out.", default="", metavar="ROWS")
@opt.many(
    "--fix fixes",
    "ROWS:COLUMN=VALUE",
    "Repair a cell, or a column in rows 9-16, in the table's unit.",
)
@opt.many("--swap swaps", "ROW,ROW", "Exchange two rows' readings.")
@opt.many(
    "--move moves",
    "ROW,ROW",
    "A row's reading belongs to the other row, those between one row nearer.",
)
@opt.many(
    "--shift shifts",
    "COLUMN[:ROWS]=STEP",
    "Readings, inclination or tool_face belong one row down (1) or up (-1).",
)
@opt.many(
    "--axes",
    "[ROWS:]X,Y,Z",
    "Columns that are the sensor's x, y, z, for example -y,x,z; of a part 17-32:-y,x,z.",
)
@opt.choice("--angle-unit", "deg rad", "Unit of the angles.")
@opt.flag("--auto-exclude", "Leave out records that the search finds wrong.")
@opt.flag("--swap-angles", "Exchange the two angle columns.")
@opt.flag("--keep-angles", "Do not refuse angles that look exchanged.")
@opt.option("--sigma", "Declared noise of a reading, mg; default: from the data.", type=float)
@limit_option("--max-inclination-error", "largest held-out inclination error, deg.")
@limit_option("--max-toolface-error", "largest held-out tool-face error, deg.")
@limit_option("--max-norm-error", "held-out error of |a|, mg rms.")
@opt.shortest_rest
@calibrating
def command(tables: tuple[Path, ...], say: Say, **options: Any) -> list[Report]:
    """Calibrate a tool's accelerometer on a bench with known tool-face and inclination.

    TABLE is a CSV or HDF5 file with one row a position. Several are power-ups of one sensor, as is
    a column session: what changes between them is told. Writes calibration.yaml, report.html and
    report.json into the folder given by -o, and prints the report.

    \b
    Examples:
      imucal lab positions.csv -o out --gravity 9.8061
      imucal lab positions.csv -o out --recording log.mcap
      imucal lab rests.csv -o out --reference norm --latitude 59.3
      imucal lab monday.csv tuesday.csv friday.csv -o out
    """
    from imucalib.calibrators.lab.files import LabFiles, calibrate_files
    from imucalib.report.files import Report
    from imucalib.report.lab import compose_lab_document

    freed_memory(large=_KEPT, kept=_KEPT)
    columns, mapping = opt.pairs(options["columns"], "--columns"), opt.mapping_of(options)
    files = LabFiles(tables[0], options["recording"], columns, mapping, others=tables[1:])
    run = calibrate_files(files, request_of(options), say)
    return [Report(run, compose_lab_document(run))]


def request_of(options: dict[str, Any]) -> LabRequest:
    """The request that the options state; raises click's usage errors."""
    from dataclasses import replace

    from imucalib.calibrators.lab.repairs import repairs_of
    from imucalib.calibrators.lab.request import LabRequest, as_published
    from imucalib.core.angle_conventions import preset
    from imucalib.units import MG

    stated = {key: options[key] for key in _CONVENTIONS if options[key] is not None}
    repairs = (options[name] for name in ("swaps", "moves", "shifts", "axes", "angle_unit"))
    as_stated = ("reference", "model", "objective", "auto_exclude", "swap_angles", "keep_angles")
    request = LabRequest(
        **shared_fields(options),
        **{name: options[name] for name in (*as_stated, "unit")},
        lsb_per_g=opt.one_scale(options["lsb"]),
        conventions=replace(preset(options["convention"]), **stated),
        fixes=tuple(fix for text in options["fixes"] for fix in _fixes(text)),
        repairs=repairs_of(*repairs),
        exclude=opt.row_numbers(options["exclude"], "--exclude"),
        train=opt.row_numbers(options["train"], "--train"),
        trust=opt.row_numbers(options["trust"], "--trust"),
        still=opt.still_of(options),
        sigma=None if options["sigma"] is None else options["sigma"] * MG,
        population=opt.population_of(
            options, options["reference"], as_published=False, objective="settings"
        ),
    )
    return as_published(request) if options["as_published"] else request


def _fixes(text: str) -> list[tuple[int, str, float]]:
    """(row, column, value) of each cell that is repaired; the columns that stand for a face such as
    +x or -z are repaired together."""
    found = re.fullmatch(r"\s*(\d+)\s*(?:-\s*(\d+)\s*)?:\s*([^=]*?)\s*=\s*(.*?)\s*", text)
    try:
        if found is None:
            raise ValueError
        first, last, role, value = found.groups()
        every, face = range(int(first), int(last or first) + 1), re.fullmatch("[+-][xyz]", value)
        if not every or (role == "face" and not face):
            raise ValueError
        cells = {role: float(value)} if role != "face" else {}
        if role == "face":
            cells = {f"u{a}": float(f"{value[0]}1") if a == value[1] else 0.0 for a in "xyz"}
        return [(row, name, number) for row in every for name, number in cells.items()]
    except ValueError:
        said = (
            f"'{text}' is not ROWS:COLUMN=VALUE, for example 10:y=-58593, 9-16:inclination=30 or "
            "8:face=+x"
        )
        raise click.BadParameter(said, param_hint="--fix") from None
