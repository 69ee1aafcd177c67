"""Options that say how a recording is read, shared by every command that reads one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from imucalib.recording.mapping import FieldMapping
    from imucalib.rests.stillness import StillSettings

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
    click.option("--time", help="Recording: time field or column; log_time for an MCAP file."),
    click.option(
        "--unit",
        help="Unit of the accelerometer's readings: m/s2, g, mg, ug, counts. Default: as the file "
        "states it, else by the norm at rest.",
    ),
    click.option("--lsb", help="Accelerometer counts a g, with --unit counts."),
    click.option("--gyro-unit", help="Recording: unit of the gyroscope: rad/s, deg/s, counts."),
    click.option("--gyro-lsb", help="Recording: gyroscope counts a deg/s, with its unit counts."),
    click.option(
        "--temperature-unit", help="Recording: unit of the temperature: degC, degF, K, counts."
    ),
    click.option(
        "--time-unit",
        help="Recording: unit of the time stamps: s, ms, us, ns, min, h, d, excel, datenum, "
        "julian, filetime, ticks, text.",
    ),
    click.option(
        "--time-format", help="CSV: strptime form of stamps, for example '%d/%m/%Y %H:%M:%S.%f'."
    ),
    click.option(
        "--where",
        multiple=True,
        metavar="COLUMN=VALUE",
        help="CSV: only rows that have the value; all of several.",
    ),
    click.option("--rate", type=float, help="Recording: samples a second, without time stamps."),
    click.option("--axis-map", help='Recording: axes, for example "x,-y,z".'),
    click.option("--preset", help="Recording: named mapping (actigraph, axivity, euroc, ...)."),
    click.option("--acc-offset", help="Accelerometer counts at zero g."),
    click.option("--skip", type=int, help="CSV: lines before the header or the first row."),
    click.option("--decimal", help="CSV: decimal mark, . or ,"),
    click.option("--max-chunk", type=int, help="MCAP: bytes that one packed chunk may unpack to."),
    click.option(
        "--allow-external", is_flag=True, default=None, help="HDF5: read data from other files."
    ),
    click.option("--delimiter", help="CSV: between the columns; tab and blank are understood."),
)

#: Option -> field of the mapping.
_FIELDS = {
    **{
        name: name
        for name in (
            "acc", "gyro", "temperature", "time", "gyro_unit", "temperature_unit", "time_unit",
            "time_format", "where", "rate",
            "axis_map", "preset", "acc_offset", "skip", "decimal", "delimiter",
            "max_chunk", "allow_external",
        )
    },
    "unit": "acc_unit",
    "lsb": "lsb_per_g",
    "gyro_lsb": "lsb_per_dps",
}  # fmt: skip


#: A fleet as a prior.
fleet_option = click.option(
    "--fleet",
    type=click.Path(path_type=Path, dir_okay=False),
    help="fleet.yaml of imucal fleet: what devices of its kind say where this one's data leave "
    "something open.",
)


def recording_options(command: Command) -> Command:
    """Add the options; `mapping_of` turns their values into a FieldMapping."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


force_option = click.option(
    "--force", is_flag=True, help="Replace an output file that is there; never an input."
)


#: Of commands that look for rests in a recording.
shortest_rest_option = click.option(
    "--shortest-rest", type=float, default=1.0, show_default=True, metavar="SECONDS",
    help="Recording: what is still for less is no rest.",
)  # fmt: skip


def still_of(options: dict[str, Any]) -> StillSettings:
    """What counts as a rest, by --shortest-rest."""
    from imucalib.errors import UsageError
    from imucalib.rests.stillness import StillSettings

    shortest = options["shortest_rest"]
    if not 0.1 <= shortest <= 3600.0:
        raise UsageError(f"--shortest-rest {shortest:g} is not between 0.1 and 3600 s")
    return StillSettings(shortest=shortest)


def inputs_of(options: dict[str, Any], *files: Path) -> list[Path]:
    """Every file that a command reads: no output may be one of them."""
    named = (options.get("mapping"), options.get("effects_file"))
    return [*files, *(path for path in named if path is not None)]


def mapping_of(options: dict[str, Any]) -> FieldMapping:
    """The mapping that the options state; the file first, single options over it."""
    from imucalib.recording.mapping import FieldMapping, from_dict, load_mapping

    words = {"tab": "\t", "\\t": "\t", "blank": " ", "blanks": " ", "space": " "}
    stated = {name: options[option] for option, name in _FIELDS.items()}
    delimiter = stated["delimiter"]
    stated["delimiter"] = words.get(delimiter, delimiter) if delimiter else None
    stated["where"] = list(stated["where"]) or None
    base = load_mapping(options["mapping"]) if options["mapping"] else FieldMapping()
    return from_dict(stated, "command line").filled_from(base)


def one_scale(text: str | None) -> float | None:
    """The value of --lsb where one number serves all axes, as in a table."""
    if text is None:
        return None
    try:
        return float(text)
    except ValueError:
        raise click.BadParameter(f"'{text}' is not one number", param_hint="--lsb") from None
