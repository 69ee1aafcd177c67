"""Options that say how a recording is read, shared by every command that reads one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from imucalib.mapping import FieldMapping

Command = TypeVar("Command", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--mapping",
        type=click.Path(path_type=Path),
        help="Recording: mapping file, as `inspect --save-mapping` writes it.",
    ),
    click.option("--acc", help="Recording: accelerometer fields or columns, x,y,z."),
    click.option("--gyro", help="Recording: gyroscope fields or columns."),
    click.option("--temperature", help="Recording: temperature field or column."),
    click.option("--time", help="Recording: time field or column."),
    click.option("--acc-unit", help="Recording: unit of the accelerometer."),
    click.option("--rate", type=float, help="Recording: samples a second, without time stamps."),
    click.option("--axis-map", help='Recording: axes, for example "x,-y,z".'),
    click.option("--preset", help="Recording: named mapping (actigraph, axivity, euroc, ...)."),
    click.option("--lsb", help="Recording: accelerometer counts a g, with --acc-unit counts."),
    click.option("--acc-offset", help="Recording: accelerometer counts at zero."),
)


def recording_options(command: Command) -> Command:
    """Add the options; `mapping_of` turns their values into a FieldMapping."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def mapping_of(options: dict[str, Any]) -> FieldMapping:
    """The mapping that the options state; the file first, single options over it."""
    from imucalib.mapping import FieldMapping, from_dict, load_mapping

    stated = from_dict(
        {
            "acc": options["acc"],
            "gyro": options["gyro"],
            "temperature": options["temperature"],
            "time": options["time"],
            "acc_unit": options["acc_unit"],
            "rate": options["rate"],
            "axis_map": options["axis_map"],
            "preset": options["preset"],
            "lsb_per_g": options["lsb"],
            "acc_offset": options["acc_offset"],
        },
        "command line",
    )
    base = load_mapping(options["mapping"]) if options["mapping"] else FieldMapping()
    return stated.filled_from(base)
