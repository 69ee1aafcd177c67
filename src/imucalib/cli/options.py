"""Options that commands share: how a recording is read, how large gravity is, what is printed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from imucalib.recording.mapping import FieldMapping
    from imucalib.rests.stillness import StillSettings

    Kind = click.ParamType[str]
else:
    Kind = click.ParamType

Command = TypeVar("Command", bound=Callable[..., Any])

#: Parameter -> what click has to know of the option of that name.
_READING: dict[str, dict[str, Any]] = {
    "mapping": {
        "type": click.Path(path_type=Path),
        "help": "Recording: mapping file, as `inspect --save-mapping` writes it.",
    },
    "acc": {"help": "Recording: accelerometer fields or columns, x,y,z."},
    "gyro": {"help": "Recording: gyroscope fields or columns."},
    "temperature": {"help": "Recording: temperature field or column."},
    "time": {"help": "Recording: time field or column; log_time for an MCAP file."},
    "unit": {
        "help": "Unit of the accelerometer's readings: m/s2, g, mg, ug, counts. Default: as the "
        "file states it, else by the norm at rest."
    },
    "lsb": {"help": "Accelerometer counts a g, with --unit counts."},
    "gyro_unit": {"help": "Recording: unit of the gyroscope: rad/s, deg/s, counts."},
    "gyro_lsb": {"help": "Recording: gyroscope counts a deg/s, with its unit counts."},
    "temperature_unit": {"help": "Recording: unit of the temperature: degC, degF, K, counts."},
    "time_unit": {
        "help": "Recording: unit of the time stamps: s, ms, us, ns, min, h, d, excel, datenum, "
        "julian, filetime, ticks, text."
    },
    "time_format": {"help": "CSV: strptime form of stamps, for example '%d/%m/%Y %H:%M:%S.%f'."},
    "where": {
        "multiple": True,
        "metavar": "COLUMN=VALUE",
        "help": "CSV: only rows that have the value; all of several.",
    },
    "rate": {"type": float, "help": "Recording: samples a second, without time stamps."},
    "axis_map": {"help": 'Recording: axes, for example "x,-y,z".'},
    "preset": {"help": "Recording: named mapping (actigraph, axivity, euroc, ...)."},
    "acc_offset": {"help": "Accelerometer counts at zero g."},
    "skip": {"type": int, "help": "CSV: lines before the header or the first row."},
    "decimal": {"help": "CSV: decimal mark, . or ,"},
    "max_chunk": {"type": int, "help": "MCAP: bytes that one packed chunk may unpack to."},
    "allow_external": {
        "is_flag": True,
        "default": None,
        "help": "HDF5: read data from other files.",
    },
    "delimiter": {"help": "CSV: between the columns; tab and blank are understood."},
}
#: Parameters of `recording_options`.
READING = tuple(_READING)

#: A fleet as a prior.
fleet_option = click.option(
    "--fleet",
    type=click.Path(path_type=Path, dir_okay=False),
    help="fleet.yaml of imucal fleet: what devices of its kind say where this one's data leave "
    "something open.",
)


def recording_options(command: Command) -> Command:
    """Add the options; `mapping_of` turns their values into a FieldMapping."""
    for name, words in reversed(_READING.items()):
        command = click.option(f"--{name.replace('_', '-')}", **words)(command)
    return command


force_option = click.option(
    "--force", is_flag=True, help="Replace an output file that is there; never an input."
)


#: Of commands that look for rests in a recording.
shortest_rest_option = click.option(
    "--shortest-rest",
    type=float,
    default=1.0,
    show_default=True,
    metavar="SECONDS",
    help="Recording: what is still for less is no rest.",
)


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
    from imucalib.recording.mapping import OPTION_FIELDS, FieldMapping, from_dict, load_mapping

    words = {"tab": "\t", "\\t": "\t", "blank": " ", "blanks": " ", "space": " "}
    single = (name for name in READING if name != "mapping")
    stated = {OPTION_FIELDS.get(name, name): options[name] for name in single}
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


_GRAVITY = (
    click.option("--gravity", type=float, help="Local gravity, m/s²; default: standard gravity."),
    click.option("--latitude", type=float, help="Latitude in degrees, for normal gravity."),
    click.option(
        "--height",
        type=float,
        default=0.0,
        help="Height above the ellipsoid in m, with --latitude.",
    ),
)


def gravity_options(command: Command) -> Command:
    """Add the options; `gravity_of` turns their values into m/s²."""
    for option in reversed(_GRAVITY):
        command = option(command)
    return command


def gravity_of(options: Mapping[str, Any]) -> tuple[float, str]:
    """Local gravity (m/s²) and where it comes from; raises click's usage errors."""
    from imucalib.units import STANDARD_GRAVITY, local_gravity

    if options["gravity"] is not None and options["latitude"] is not None:
        raise click.UsageError("--gravity and --latitude exclude each other")
    if options["gravity"] is not None:
        if not 9.7 < options["gravity"] < 9.9:
            raise click.BadParameter(
                "local gravity is between 9.7 and 9.9 m/s²", param_hint="--gravity"
            )
        return options["gravity"], "as given"
    if options["latitude"] is not None:
        value = local_gravity(options["latitude"], options["height"])
        return (
            value,
            f"normal gravity at latitude {options['latitude']:g}, height {options['height']:g} m",
        )
    return STANDARD_GRAVITY, "standard gravity; --gravity or --latitude gives the local value"


class ExportForm(Kind):
    """The name of an export, whichever files there are."""

    name = "form"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from imucalib.exports import exports

        if value not in exports():
            self.fail(f"'{value}' is none of {', '.join(exports())}", param, ctx)
        return str(value)


class FormOption(click.Option):
    """An option that names an export; its help lists them."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        from imucalib.exports import exports

        name, text = super().get_help_record(ctx) or ("", "")
        return name, f"{text.rstrip('.')}: {', '.join(exports())}."


EXPORT_FORM = ExportForm()
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
quiet_option = click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors.")
full_option = click.option("--full", is_flag=True, help="Print every section, not one page.")
seed_option = click.option(
    "--seed", default=0, show_default=True, help="Seed of all randomness: same seed, same result."
)


def numbers(text: str, what: str) -> tuple[int, ...]:
    """ "1-20,25" as row numbers; raises click's usage error."""
    rows: list[int] = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            rows += range(low, int(last) + 1) if dash else [low]
        except ValueError:
            raise click.BadParameter(
                f"'{part}' is not a row or a range such as 1-20", param_hint=what
            ) from None
    return tuple(rows)


def pairs(texts: tuple[str, ...], what: str) -> dict[str, str]:
    """ "a=b,c=d" options as a dictionary; raises click's usage error."""
    found: dict[str, str] = {}
    for part in (p for text in texts for p in text.split(",") if p.strip()):
        name, sign, value = part.partition("=")
        if not sign:
            raise click.BadParameter(f"'{part}' is not of the form name=value", param_hint=what)
        found[name.strip()] = value.strip()
    return found


#: Lines of 80 columns.
PAGE = 60
#: Heading -> options, by parameter name, that a help longer than a page leaves to --help-all.
RARE = {
    "Reading a recording": (*(name for name in READING if name != "unit"), "shortest_rest"),
    "Angles and rows of a table": (
        "gravity_sign",
        "z_axis",
        "inclination_zero",
        "toolface_zero_axis",
        "toolface_sense",
        "toolface_offset",
        "angle_unit",
        "swap_angles",
        "keep_angles",
        "axes",
        "swaps",
        "moves",
        "shifts",
    ),
    "Fit and search": (
        "train",
        "model",
        "objective",
        "sigma",
        "as_published",
        "arithmetic",
        "loop",
        "curves",
        "seed",
        "height",
        "effects_file",
        "fleet",
        "without",
    ),
    "Posterior of an array": (
        "as_drawn",
        "sampler",
        "samples",
        "motion_prior",
        "det_exponent",
        "acc_sigma",
        "gyro_covariance",
        "chains",
        "ess",
        "iterations",
        "save_draws",
        "checkpoint",
        "accept_mm",
        "accept_mg",
        "accept_dps",
    ),
    "Limits": (
        "max_inclination_error",
        "max_toolface_error",
        "max_norm_error",
        "max_worst_error",
        "max_gyro_error",
        "max_position_sd",
        "fail_on",
    ),
    "Studies": ("entry",),
}
_HEADING = {name: heading for heading, names in RARE.items() for name in names}
_ASKED = "imucal.help_all"

Records = list[tuple[str, str]]


def _show_all(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[_ASKED] = True
        click.echo(ctx.get_help(), color=ctx.color)
        ctx.exit()


_HELP_ALL = click.Option(
    ["--help-all"],
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_show_all,
    help="Show every option and exit.",
)


class PagedCommand(click.Command):
    """A command whose help, where it is longer than a page, leaves rare options to --help-all."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*super().get_params(ctx), _HELP_ALL]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        if self._fits(ctx):
            _write(formatter, self._in_order(ctx))
            return
        usual, rare = self._records(ctx)
        _write(formatter, usual)
        if ctx.meta.get(_ASKED):
            for heading, records in rare.items():
                _write(formatter, records, heading)
        else:
            formatter.write_paragraph()
            count = sum(map(len, rare.values()))
            what = ", ".join(heading.lower() for heading in rare)
            formatter.write_text(f"{ctx.command_path} --help-all: {count} more options ({what}).")

    def _records(self, ctx: click.Context) -> tuple[Records, dict[str, Records]]:
        """Usual options, and the others by heading."""
        usual: Records = []
        rare: dict[str, Records] = {}
        for param in self.get_params(ctx):
            if record := _record(param, ctx):
                heading = _HEADING.get(str(param.name))
                (rare.setdefault(heading, []) if heading else usual).append(record)
        return usual, {heading: rare[heading] for heading in RARE if heading in rare}

    def _in_order(self, ctx: click.Context) -> Records:
        """All options in one list; there is nothing that --help-all would add."""
        params = (p for p in self.get_params(ctx) if p is not _HELP_ALL)
        return [record for p in params if (record := _record(p, ctx))]

    def _fits(self, ctx: click.Context) -> bool:
        """Whether the whole help is a page, whatever the terminal's width."""
        page = click.HelpFormatter(width=78)
        self.format_usage(ctx, page)
        self.format_help_text(ctx, page)
        _write(page, self._in_order(ctx))
        self.format_epilog(ctx, page)
        return page.getvalue().count("\n") <= PAGE


def _record(param: click.Parameter, ctx: click.Context) -> tuple[str, str] | None:
    return param.get_help_record(ctx) if isinstance(param, click.Option) else None


def _write(formatter: click.HelpFormatter, records: Records, heading: str = "Options") -> None:
    with formatter.section(heading):
        formatter.write_dl(records)
