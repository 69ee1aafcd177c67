"""imucal lab"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.calibrating import calibrating, calibrating_of, finish, limit_option, shared_of
from imucalib.cli.options import (
    PATH,
    choice,
    flag,
    fleet_option,
    many,
    mapping_of,
    numbers,
    one_scale,
    option,
    paged,
    pairs,
    population_of,
    shortest_rest_option,
    still_of,
)
from imucalib.cli.output import freed_memory

if TYPE_CHECKING:
    from imucalib.calibrators.lab.request import LabRequest

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


@paged(
    "lab",
    click.argument("tables", metavar="TABLE...", nargs=-1, required=True, type=PATH),
    option(
        "--recording",
        "Recording with the positions of TABLE in order; its still segments are averaged.",
        type=PATH,
    ),
    choice(
        "--reference",
        "vector direction norm",
        "Known angles; directions without dials (a column face with +x ... -z, or ux, uy, "
        "uz); or only the size of gravity (TABLE may then be a recording).",
        default="vector",
    ),
    many(
        "--columns",
        "ROLE=NAME,...",
        "By heading: inclination, tool_face, face, x, y, z, temperature, samples, driver.",
    ),
    option("--convention", "Angles: paper, drilling-gravity or drilling-force.", default="paper"),
    choice("--gravity-sign", "down up", "Which way an axis points that reads +g."),
    choice("--z-axis", "down-hole up-hole", "The tool's end to which z points."),
    choice("--inclination-zero", "horizontal vertical", "What inclination 0 means."),
    choice("--toolface-zero-axis", "+x -x +y -y", "Axis that reads most at tool-face 0."),
    choice("--toolface-sense", "clockwise counter-clockwise", "Clockwise: from +y towards +x."),
    option("--toolface-offset", "Degrees added to every tool-face.", type=float),
    option("--model", "linear12 or geometric9.", default="linear12"),
    choice(
        "--objective",
        "settings vector angles paper",
        "What is minimised; settings: angles are uncertain as set.",
        default="settings",
    ),
    fleet_option,
    flag("--as-published", "The paper's own method, as it was published."),
    option(
        "--train",
        "Rows to choose and fit on, for example 1-20; the rest tests.",
        default="",
        metavar="ROWS",
    ),
    option("--exclude", "Leave rows out.", default="", metavar="ROWS"),
    many(
        "--fix fixes",
        "ROWS:COLUMN=VALUE",
        "Repair a cell, or a column in rows 9-16, in the table's unit.",
    ),
    many("--swap swaps", "ROW,ROW", "Exchange two rows' readings."),
    many(
        "--move moves",
        "ROW,ROW",
        "A row's reading belongs to the other row, those between one row nearer.",
    ),
    many(
        "--shift shifts",
        "COLUMN[:ROWS]=STEP",
        "Readings, inclination or tool_face belong one row down (1) or up (-1).",
    ),
    many(
        "--axes",
        "[ROWS:]X,Y,Z",
        "Columns that are the sensor's x, y, z, for example -y,x,z; of a part 17-32:-y,x,z.",
    ),
    choice("--angle-unit", "deg rad", "Unit of the angles."),
    flag("--auto-exclude", "Leave out records that the search finds wrong."),
    flag("--swap-angles", "Exchange the two angle columns."),
    flag("--keep-angles", "Do not refuse angles that look exchanged."),
    option("--sigma", "Declared noise of a reading, mg; default: from the data.", type=float),
    limit_option("--max-inclination-error", "largest held-out inclination error, deg."),
    limit_option("--max-toolface-error", "largest held-out tool-face error, deg."),
    limit_option("--max-norm-error", "held-out error of |a|, mg rms."),
    shortest_rest_option,
    calibrating,
)
def command(tables: tuple[Path, ...], **options: Any) -> int:
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
    from imucalib.report.lab import lab_document

    freed_memory(large=_KEPT, kept=_KEPT)
    columns, mapping = pairs(options["columns"], "--columns"), mapping_of(options)
    files = LabFiles(tables[0], options["recording"], columns, mapping, others=tables[1:])
    with calibrating_of(options) as say:
        run = calibrate_files(files, request_of(options), say)
    return finish([Report(run, lab_document(run))], options)


def request_of(options: dict[str, Any]) -> LabRequest:
    """The request that the options state; raises click's usage errors."""
    from dataclasses import replace

    from imucalib.calibrators.lab.conventions import preset
    from imucalib.calibrators.lab.repairs import repairs_of
    from imucalib.calibrators.lab.request import LabRequest, as_published
    from imucalib.units import MG

    stated = {key: options[key] for key in _CONVENTIONS if options[key] is not None}
    repairs = (options[name] for name in ("swaps", "moves", "shifts", "axes", "angle_unit"))
    as_stated = ("reference", "model", "objective", "auto_exclude", "swap_angles", "keep_angles")
    request = LabRequest(
        **shared_of(options),
        **{name: options[name] for name in (*as_stated, "unit")},
        lsb_per_g=one_scale(options["lsb"]),
        conventions=replace(preset(options["convention"]), **stated),
        fixes=tuple(fix for text in options["fixes"] for fix in _fixes(text)),
        repairs=repairs_of(*repairs),
        exclude=numbers(options["exclude"], "--exclude"),
        train=numbers(options["train"], "--train"),
        still=still_of(options),
        sigma=None if options["sigma"] is None else options["sigma"] * MG,
        population=population_of(
            options,
            {"as_published": False, "objective": "settings"},
            options["reference"],
            "give --reference {other}, or a fleet of that reference",
        ),
    )
    return as_published(request) if options["as_published"] else request


def _face(value: str) -> dict[str, float]:
    """The columns that stand for a face such as +x or -z."""
    sign, axis = value.strip()[:1], value.strip()[1:]
    if sign not in ("+", "-") or axis not in ("x", "y", "z"):
        raise ValueError
    return {f"u{a}": float(f"{sign}1") if a == axis else 0.0 for a in "xyz"}


def _fixes(text: str) -> list[tuple[int, str, float]]:
    rows, colon, cell = text.partition(":")
    role, sign, value = cell.partition("=")
    try:
        if not colon or not sign:
            raise ValueError
        first, _, last = rows.partition("-")
        every = range(int(first), int(last or first) + 1)
        if not every:
            raise ValueError
        cells = _face(value) if role.strip() == "face" else {role.strip(): float(value)}
        return [(row, name, number) for row in every for name, number in cells.items()]
    except ValueError:
        said = (
            f"'{text}' is not ROWS:COLUMN=VALUE, for example 10:y=-58593, 9-16:inclination=30 or "
            "8:face=+x"
        )
        raise click.BadParameter(said, param_hint="--fix") from None
