"""Options of `imucal lab`, and the request that their values make."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from imucalib.cli.calibrating import limit_option, shared_of
from imucalib.cli.options import fleet_option, numbers, one_scale, still_of

if TYPE_CHECKING:
    from imucalib.calibrators.lab.request import LabRequest
    from imucalib.calibrators.population import Population

Command = TypeVar("Command", bound=Callable[..., Any])

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
        "--recording",
        type=click.Path(path_type=Path),
        help="Recording with the positions of TABLE in order; its still segments are averaged.",
    ),
    click.option(
        "--reference",
        type=click.Choice(["vector", "direction", "norm"]),
        default="vector",
        show_default=True,
        help="Known angles; directions without dials (a column face with +x ... -z, or ux, uy, "
        "uz); or only the size of gravity (TABLE may then be a recording).",
    ),
    click.option(
        "--columns",
        multiple=True,
        metavar="ROLE=NAME,...",
        help="By heading: inclination, tool_face, face, x, y, z, temperature, samples, driver.",
    ),
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
    fleet_option,
    click.option(
        "--as-published", is_flag=True, help="The paper's own method, as it was published."
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
        metavar="ROWS:COLUMN=VALUE",
        help="Repair a cell, or a column in rows 9-16, in the table's unit.",
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
    click.option(
        "--axes",
        multiple=True,
        metavar="[ROWS:]X,Y,Z",
        help="Columns that are the sensor's x, y, z, for example -y,x,z; of a part 17-32:-y,x,z.",
    ),
    click.option("--angle-unit", type=click.Choice(["deg", "rad"]), help="Unit of the angles."),
    click.option(
        "--auto-exclude", is_flag=True, help="Leave out records that the search finds wrong."
    ),
    click.option("--swap-angles", is_flag=True, help="Exchange the two angle columns."),
    click.option("--keep-angles", is_flag=True, help="Do not refuse angles that look exchanged."),
    click.option(
        "--sigma", type=float, help="Declared noise of a reading, mg; default: from the data."
    ),
    limit_option("--max-inclination-error", "largest held-out inclination error, deg."),
    limit_option("--max-toolface-error", "largest held-out tool-face error, deg."),
    limit_option("--max-norm-error", "held-out error of |a|, mg rms."),
)


def lab_options(command: Command) -> Command:
    """Add the options; `request_of` turns their values into a LabRequest."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def request_of(options: dict[str, Any]) -> LabRequest:
    """The request that the options state; raises click's usage errors."""
    from dataclasses import replace

    from imucalib.calibrators.lab.conventions import preset
    from imucalib.calibrators.lab.repairs import repairs_of
    from imucalib.calibrators.lab.request import LabRequest, as_published
    from imucalib.units import MG

    shared = shared_of(options)
    stated = {key: options[key] for key in _CONVENTIONS if options[key] is not None}
    request = LabRequest(
        unit=options["unit"],
        lsb_per_g=one_scale(options["lsb"]),
        gravity=shared.gravity,
        gravity_source=shared.gravity_source,
        reference=options["reference"],
        model=options["model"],
        objective=options["objective"],
        conventions=replace(preset(options["convention"]), **stated),
        fixes=tuple(fix for text in options["fixes"] for fix in _fixes(text)),
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
        still=still_of(options),
        declare=shared.declare,
        only=shared.only,
        without=shared.without,
        loop=shared.loop,
        curves=LabRequest.curves if shared.curves is None else shared.curves,
        extra_effects=shared.extra_effects,
        sigma=None if options["sigma"] is None else options["sigma"] * MG,
        population=_population(options),
        limits=shared.limits,
        seed=shared.seed,
        command=shared.command,
    )
    return as_published(request) if options["as_published"] else request


def _population(options: dict[str, Any]) -> Population | None:
    from imucalib.calibrators.population import read
    from imucalib.errors import UsageError

    if options["fleet"] is None:
        return None
    for name, usual in (("as_published", False), ("objective", "settings")):
        if options[name] != usual:
            option = name.replace("_", "-")
            raise UsageError(
                f"--{option} knows no prior", remedy=f"leave out --fleet or --{option}"
            )
    kind = read(options["fleet"])
    if kind.reference != options["reference"]:
        raise UsageError(
            f"the fleet was calibrated with --reference {kind.reference}, this device with "
            f"{options['reference']}",
            where=str(options["fleet"]),
            remedy=f"give --reference {kind.reference}, or a fleet of that reference",
        )
    return kind


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
        raise click.BadParameter(
            f"'{text}' is not ROWS:COLUMN=VALUE, for example 10:y=-58593, 9-16:inclination=30 or "
            "8:face=+x",
            param_hint="--fix",
        ) from None
