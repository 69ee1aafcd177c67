"""Options of `imucal lab`, and the request that their values make."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from imucalib.cli.gravity_options import gravity_of, gravity_options, limits_of
from imucalib.cli.output import numbers

if TYPE_CHECKING:
    from imucalib.calibrators.lab.calibrate import LabSettings
    from imucalib.calibrators.lab.request import LabRequest

Command = TypeVar("Command", bound=Callable[..., Any])

_LIMITS = ("max-error", "max-inclination-error", "max-toolface-error", "max-norm-error")
_CONVENTIONS = (
    "gravity_sign",
    "z_axis",
    "inclination_zero",
    "toolface_zero_axis",
    "toolface_sense",
    "toolface_offset",
)
_OPTIONS = (
    click.option(
        "-o",
        "--output",
        type=click.Path(path_type=Path),
        help="Folder for calibration.yaml, report.html and report.json.",
    ),
    click.option(
        "--recording",
        type=click.Path(path_type=Path),
        help="Recording with the positions of TABLE in order; its still segments are averaged.",
    ),
    click.option(
        "--reference",
        type=click.Choice(["vector", "norm"]),
        default="vector",
        show_default=True,
        help="Known angles, or only the size of gravity (TABLE may then be a recording).",
    ),
    click.option(
        "--columns",
        multiple=True,
        metavar="ROLE=NAME,...",
        help="Columns by heading: inclination, tool_face, x, y, z, temperature, samples.",
    ),
    click.option(
        "--unit", help="Unit of raw x, y, z: g, mg, ug, m/s2, counts. Default: by the norm at rest."
    ),
    click.option("--lsb-per-g", type=float, help="Counts a g, with --unit counts."),
    click.option(
        "--convention",
        default="paper",
        show_default=True,
        help="Angles: paper, drilling-gravity or drilling-force.",
    ),
    click.option(
        "--gravity-sign",
        type=click.Choice(["down", "up"]),
        help="Which way an axis points that reads +g.",
    ),
    click.option(
        "--z-axis",
        type=click.Choice(["down-hole", "up-hole"]),
        help="The tool's end to which z points.",
    ),
    click.option(
        "--inclination-zero",
        type=click.Choice(["horizontal", "vertical"]),
        help="What inclination 0 means.",
    ),
    click.option(
        "--toolface-zero-axis",
        type=click.Choice(["+x", "-x", "+y", "-y"]),
        help="Axis that reads most at tool-face 0.",
    ),
    click.option(
        "--toolface-sense",
        type=click.Choice(["clockwise", "counter-clockwise"]),
        help="Clockwise: from +y towards +x.",
    ),
    click.option("--toolface-offset", type=float, help="Degrees added to every tool-face."),
    click.option("--model", default="linear12", show_default=True, help="linear12 or geometric9."),
    click.option(
        "--objective",
        type=click.Choice(["settings", "vector", "angles", "paper"]),
        default="settings",
        show_default=True,
        help="What is minimised; settings: angles are uncertain as set.",
    ),
    click.option(
        "--as-published", is_flag=True, help="Paper 004's own method and split (its Table 2)."
    ),
    click.option(
        "--train",
        default="",
        metavar="ROWS",
        help="Rows to choose and fit on, for example 1-20; the rest tests.",
    ),
    click.option("--exclude", default="", metavar="ROWS", help="Leave rows out."),
    click.option(
        "--fix",
        "fixes",
        multiple=True,
        metavar="ROW:COLUMN=VALUE",
        help="Repair one cell, in the table's unit.",
    ),
    click.option(
        "--swap", "swaps", multiple=True, metavar="ROW,ROW", help="Exchange two rows' readings."
    ),
    click.option(
        "--move",
        "moves",
        multiple=True,
        metavar="ROW,ROW",
        help="A row's reading belongs to the other row, those between one row nearer.",
    ),
    click.option(
        "--shift",
        "shifts",
        multiple=True,
        metavar="COLUMN[:ROWS]=STEP",
        help="Readings, inclination or tool_face belong one row down (1) or up (-1).",
    ),
    click.option("--axes", help="Columns that are the sensor's x, y, z, for example -y,x,z."),
    click.option("--angle-unit", type=click.Choice(["deg", "rad"]), help="Unit of the angles."),
    click.option(
        "--auto-exclude", is_flag=True, help="Leave out records that the search finds wrong."
    ),
    click.option("--swap-angles", is_flag=True, help="Exchange the two angle columns."),
    click.option("--keep-angles", is_flag=True, help="Do not refuse angles that look exchanged."),
    click.option(
        "--sigma", type=float, help="Declared noise of a reading, mg; default: from the data."
    ),
    click.option(
        "--declare", multiple=True, metavar="EFFECT", help="Put an effect into the base model."
    ),
    click.option("--only", multiple=True, metavar="EFFECT", help="Search only these effects."),
    click.option(
        "--without", multiple=True, metavar="EFFECT", help="Leave effects out of the search."
    ),
    click.option(
        "--effects",
        "effects_file",
        type=click.Path(path_type=Path),
        help="Python file with effects of your own.",
    ),
    click.option("--no-loop", is_flag=True, help="Fit the base model only."),
    click.option(
        "--curves",
        is_flag=True,
        help="Correct structure without a name by a smooth curve, where that holds out.",
    ),
    click.option(
        "--draws", default=1000, show_default=True, help="Simulated data sets behind each p-value."
    ),
    click.option("--max-error", type=float, help="Limit: held-out error, mg rms; exit 1 beyond."),
    click.option(
        "--max-inclination-error",
        type=float,
        help="Limit: largest held-out inclination error, deg.",
    ),
    click.option(
        "--max-toolface-error", type=float, help="Limit: largest held-out tool-face error, deg."
    ),
    click.option("--max-norm-error", type=float, help="Limit: held-out error of |a|, mg rms."),
)


def lab_options(command: Command) -> Command:
    """Add the options; `request_of` turns their values into a LabRequest."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return gravity_options(command)


def request_of(options: dict[str, Any]) -> LabRequest:
    """The request that the options state; raises click's usage errors."""
    from imucalib.calibrators.lab.repairs import repairs_of
    from imucalib.calibrators.lab.request import LabRequest, as_published

    settings = _settings(options)
    gravity, source = gravity_of(options)
    request = LabRequest(
        unit=options["unit"],
        lsb_per_g=options["lsb_per_g"],
        gravity=gravity,
        gravity_source=source,
        reference=options["reference"],
        fixes=tuple(_fix(text) for text in options["fixes"]),
        repairs=repairs_of(
            options["swaps"],
            options["moves"],
            options["shifts"],
            options["axes"],
            options["angle_unit"],
        ),
        exclude=numbers(options["exclude"], "--exclude"),
        auto_exclude=options["auto_exclude"],
        swap_angles=options["swap_angles"],
        keep_angles=options["keep_angles"],
        train=numbers(options["train"], "--train"),
        limits=limits_of(options, _LIMITS),
        settings=settings,
        seed=options["seed"],
    )
    return as_published(request) if options["as_published"] else request


def _settings(options: dict[str, Any]) -> LabSettings:
    from dataclasses import replace

    from imucalib.calibrators.lab.calibrate import LabSettings
    from imucalib.calibrators.lab.conventions import preset
    from imucalib.effects import load_file
    from imucalib.loop.found import LoopSettings
    from imucalib.units import MG

    stated = {key: options[key] for key in _CONVENTIONS if options[key] is not None}
    return LabSettings(
        model=options["model"],
        objective=options["objective"],
        declare=options["declare"],
        only=options["only"],
        without=options["without"],
        loop=not options["no_loop"],
        sigma=None if options["sigma"] is None else options["sigma"] * MG,
        rules=LoopSettings(draws=options["draws"], curves=options["curves"]),
        extra_effects=load_file(options["effects_file"]) if options["effects_file"] else {},
        conventions=replace(preset(options["convention"]), **stated),
    )


def _fix(text: str) -> tuple[int, str, float]:
    row, colon, cell = text.partition(":")
    role, sign, value = cell.partition("=")
    try:
        if not colon or not sign:
            raise ValueError
        return int(row), role.strip(), float(value)
    except ValueError:
        raise click.BadParameter(
            f"'{text}' is not ROW:COLUMN=VALUE, for example 10:y=-58593", param_hint="--fix"
        ) from None
