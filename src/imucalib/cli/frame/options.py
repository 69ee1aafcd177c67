"""Options that commands share: how a recording is read, how large gravity is, what is printed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.core import ParameterSource

from imucalib.cli.frame.output import note
from imucalib.question import paste

if TYPE_CHECKING:
    from imucalib.calibration.calibration import Calibration
    from imucalib.calibrators.population import Population
    from imucalib.recording.mapping import FieldMapping
    from imucalib.rests.stillness import StillSettings

    Kind = click.ParamType[str]
else:
    Kind = click.ParamType

Parameter = Callable[[Any], Any]
Made = TypeVar("Made")
PATH = click.Path(path_type=Path)
FILE = click.Path(path_type=Path, dir_okay=False)
FOLDER = click.Path(path_type=Path, file_okay=False)
#: Between pairs: a name follows, so that commas of a heading are its own.
_PAIRS = re.compile(r",(?=[^,=]*=|\s*$)")
#: Lines of 80 columns.
PAGE = 60
#: How an option begins whose breach is exit 1, and its help.
_LIMIT, LIMIT_HELP = "--max-", "Limit: "
#: Parameter -> help of the option of that name.
_READING = {
    "mapping": "Recording: mapping file, as `inspect --save-mapping` writes it.",
    "sensor": "Recording: which sensor, by its name, where there are several; imu: all, each "
    "by itself.",
    "acc": "Recording: accelerometer fields or columns, x,y,z.",
    "gyro": "Recording: gyroscope fields or columns.",
    "temperature": "Recording: temperature field or column.",
    "time": "Recording: time field or column; log_time for an MCAP file.",
    "unit": "Unit of the accelerometer's readings: m/s2, g, mg, ug, counts. Default: as the file "
    "states it, else by the norm at rest.",
    "lsb": "Accelerometer counts a g, with --unit counts.",
    "gyro_unit": "Recording: unit of the gyroscope: rad/s, deg/s, counts.",
    "gyro_lsb": "Recording: gyroscope counts a deg/s, with its unit counts.",
    "temperature_unit": "Recording: unit of the temperature: degC, degF, K, counts.",
    "time_unit": "Recording: unit of the time stamps: s, ms, us, ns, min, h, d, excel, datenum, "
    "julian, filetime, ticks, text.",
    "time_format": "CSV: strptime form of stamps, for example '%d/%m/%Y %H:%M:%S.%f'.",
    "where": "CSV: only rows that have the value; all of several.",
    "rate": "Recording: samples a second, without time stamps.",
    "axis_map": 'Recording: axes, for example "x,-y,z".',
    "preset": "Recording: named mapping (actigraph, axivity, euroc, ...).",
    "acc_offset": "Accelerometer counts at zero g.",
    "skip": "CSV: lines before the header or the first row.",
    "decimal": "CSV: decimal mark, . or ,",
    "max_chunk": "MCAP: bytes that one packed chunk may unpack to.",
    "allow_external": "HDF5: read data from other files.",
    "delimiter": "CSV: between the columns; tab and blank are understood.",
}
#: What click has to know of those that are no text.
_FORMS: dict[str, dict[str, Any]] = {
    "mapping": {"type": PATH},
    "where": {"multiple": True, "metavar": "COLUMN=VALUE"},
    "rate": {"type": float},
    "skip": {"type": int},
    "max_chunk": {"type": int},
    "allow_external": {"is_flag": True, "default": None},
}
#: Parameters of `recording`.
READING = tuple(_READING)
_WHOLE_HELP = "imucal.help_all"
Records = list[tuple[str, str]]


def option(names: str, text: str, **words: Any) -> Parameter:
    """As click.option: spellings and name separated by blanks, its help, and click's words; a
    default that says something is shown."""
    shown = words.get("default") not in (None, "")
    return click.option(*names.split(), help=text, **{"show_default": shown, **words})


#: Options without a value, and those whose value is any path, a file's or a folder's.
flag = partial(option, is_flag=True)
path, file, folder = (partial(option, type=kind) for kind in (PATH, FILE, FOLDER))


def many(names: str, metavar: str, text: str) -> Parameter:
    """An option that may be repeated."""
    return option(names, text, multiple=True, metavar=metavar)


def choice(names: str, words: str, text: str, **more: Any) -> Parameter:
    """An option whose value is one of some words."""
    return option(names, text, type=click.Choice(words.split()), **more)


def combine(parameters: Iterable[Parameter]) -> Parameter:
    """Several parameters as one, in the order of the help."""
    made = tuple(parameters)

    def add(command: Any) -> Any:
        for parameter in reversed(made):
            command = parameter(command)
        return command

    return add


#: How a recording is read; `mapping_of` turns the values into a FieldMapping.
recording = combine(
    option(f"--{name.replace('_', '-')}", text, **_FORMS.get(name, {}))
    for name, text in _READING.items()
)
#: How large gravity is; `gravity_of` turns the values into m/s².
gravity = combine(
    [
        option("--gravity", "Local gravity, m/s²; default: standard gravity.", type=float),
        option("--latitude", "Latitude in degrees, for normal gravity.", type=float),
        option(
            "--height",
            "Height above the ellipsoid in m, with --latitude.",
            default=0.0,
            show_default=False,
        ),
    ]
)
fleet = file(
    "--fleet",
    "fleet.yaml of imucal fleet: what devices of its kind say where this one's data leave "
    "something open.",
)
#: Of commands that look for rests in a recording.
shortest_rest = option(
    "--shortest-rest",
    "Recording: what is still for less is no rest.",
    default=1.0,
    metavar="SECONDS",
)
strict = flag("--strict", "Refuse a damaged recording instead of keeping what is left.")
effects = path(
    "--effects effects_file", "Python file with effects of your own that the calibration uses."
)
own_effects = path("--effects effects_file", "Python file with effects of your own.")
only = many("--only", "EFFECT", "Search only these effects.")
without = many("--without", "EFFECT", "Leave effects out of the search.")
same_device = flag(
    "--same-device",
    "Use the calibration although names or numbers say that it is another sensor's.",
)
convention = option(
    "--convention", "Angles: paper, drilling-gravity or drilling-force.", default="paper"
)
force = flag("--force", "Replace an output file that is there; never an input.")
json = flag("--json as_json", "Print the result as JSON.")
quiet = flag("-q --quiet", "Print nothing but errors.")
verbose = flag("-v --verbose", "Say when each thing happened, and what it cost.")
full = flag("--full", "Print every section, not one page.")
#: Of commands that write, and print what they found in a line or as a page.
line_options = combine([force, json, quiet])
page_options = combine([force, full, json, quiet])
seed = option("--seed", "Seed of all randomness: same seed, same result.", default=0)


def still_of(options: Mapping[str, Any]) -> StillSettings:
    """What counts as a rest, by --shortest-rest."""
    from imucalib.errors import UsageError
    from imucalib.rests.stillness import StillSettings

    shortest = options["shortest_rest"]
    if not 0.1 <= shortest <= 3600.0:
        raise UsageError(f"--shortest-rest {shortest:g} is not between 0.1 and 3600 s")
    return StillSettings(shortest=shortest)


def retype(chosen: Callable[[str, ParameterSource | None], bool]) -> list[str]:
    """Some options of the command that runs, as they would be typed.

    chosen : whether one is meant, by its parameter's name and where its value comes from
    """
    ctx, words = click.get_current_context(), list[str]()
    for parameter in ctx.command.params:
        name = parameter.name or ""
        if not chosen(name, ctx.get_parameter_source(name)):
            continue
        long = next(o for o in parameter.opts if o.startswith("--"))
        value = ctx.params[name]
        if isinstance(parameter, click.Option) and parameter.is_flag:
            words += [long] if value else parameter.secondary_opts[:1]
            continue
        for one in value if isinstance(value, tuple) else (value,):
            words += [long, f"{one:.15g}" if isinstance(one, float) else str(one)]
    return words


def repeat_typed(*files: Path, without: tuple[str, ...] = ()) -> str:
    """Files and what was typed of their reading, but for some options, for the next command."""
    typed, of_reading = ParameterSource.COMMANDLINE, set(READING) - set(without)
    words = retype(lambda name, source: name in of_reading and source is typed)
    return paste(*files, *words)


def demand_outputs(options: Mapping[str, Any], outputs: Iterable[Path | None], *read: Path) -> None:
    """Refuse, before the work, an output, that of --html too, that is a file which the command
    reads, or that is there and is not to be replaced. Raises UsageError."""
    from imucalib.atomic_file import demand_output

    named = (options.get(name) for name in ("mapping", "effects_file", "noise"))
    inputs = [*read, *(one for one in named if isinstance(one, Path))]
    for output in filter(None, (*outputs, options.get("html"))):
        demand_output(output, inputs, force=options["force"])


def calibration_of(path: Path, options: Mapping[str, Any]) -> Calibration:
    """Read and checked, after the user's own effects; with --same-device that of whichever sensor
    it is used for. Raises UnreadableInput."""
    from imucalib.calibration.file import check, read
    from imucalib.effects import load_file

    if options.get("effects_file") is not None:
        load_file(options["effects_file"])
    found = read(path)
    check(found, str(path))
    return replace(found, sensor=None) if options.get("same_device") else found


def population_of(options: Mapping[str, Any], reference: str, **usual: Any) -> Population | None:
    """What --fleet says of the device. Raises UsageError.

    reference : by which the device is calibrated
    usual : values of options that know no prior, by name
    """
    from imucalib.calibrators.population import read
    from imucalib.errors import UsageError

    if options["fleet"] is None:
        return None
    for name, value in usual.items():
        if options[name] != value:
            option = f"--{name.replace('_', '-')}"
            raise UsageError(f"{option} knows no prior", remedy=f"leave out --fleet or {option}")
    kind = read(options["fleet"])
    if kind.reference != reference:
        other = f"give --reference {kind.reference}, or " if "reference" in options else ""
        raise UsageError(
            f"the fleet was calibrated by {kind.reference}, this device is by {reference}",
            where=str(options["fleet"]),
            remedy=f"{other}give a fleet that was calibrated by {reference}",
        )
    return kind


def mapping_of(options: Mapping[str, Any]) -> FieldMapping:
    """The mapping that the options state; the file first, single options over it."""
    from imucalib.recording.mapping import OPTION_FIELDS, FieldMapping, from_dict, load_mapping

    words = {"tab": "\t", "\\t": "\t", "blank": " ", "blanks": " ", "space": " "}
    single = (name for name in READING if name != "mapping")
    stated = {OPTION_FIELDS.get(name, name): options[name] for name in single}
    delimiter = stated["delimiter"]
    stated["delimiter"] = words.get(delimiter, delimiter) if delimiter else None
    stated["where"] = list(stated["where"]) or None
    base = load_mapping(options["mapping"]) if options["mapping"] else FieldMapping()
    return from_dict(stated, "command line").fill_from(base)


def read_as_calibrated(
    calibration: Calibration, options: Mapping[str, Any], deed: Callable[[FieldMapping], Made]
) -> Made:
    """What a deed makes of the mapping that the options state. Where a log cannot be read by that,
    what is not stated is as it was of the recording that was calibrated: another log of the same
    logger lacks the same. Raises as the deed does."""
    from imucalib.errors import ImucalError, UnreadableInput, UsageError
    from imucalib.recording.mapping import from_dict

    stated = mapping_of(options)
    try:
        return deed(stated)
    except (UnreadableInput, UsageError) as refused:
        known = dict(calibration.facts.get("provenance", {}).get("mapping", {}))
        own = {name: value for name, value in known.items() if name not in ("sensor", "triads")}
        try:
            made = deed(stated.fill_from(from_dict(own)))
        except ImucalError:
            raise refused from None
        why = refused.what.partition("\n")[0].rstrip(":")
        note(f"{why}: read as what was calibrated", options["quiet"])
        return made


def one_scale(text: str | None) -> float | None:
    """The value of --lsb where one number serves all axes, as in a table."""
    try:
        return None if text is None else float(text)
    except ValueError:
        raise click.BadParameter(f"'{text}' is not one number", param_hint="--lsb") from None


def gravity_of(options: Mapping[str, Any]) -> tuple[float, str]:
    """Local gravity (m/s²) and where it comes from. Raises UsageError."""
    from imucalib.units import STANDARD_GRAVITY, resolve_gravity

    given = options["gravity"]
    if given is not None and not 9.7 < given < 9.9:
        said = "local gravity is between 9.7 and 9.9 m/s²"
        raise click.BadParameter(said, param_hint="--gravity")
    default = "standard gravity; --gravity or --latitude gives the local value"
    found = resolve_gravity(given, options["latitude"], options["height"])
    return found or (STANDARD_GRAVITY, default)


class FormName(Kind):
    """The name of another program's form, looked up when it is given or listed.

    names : gives all of them
    """

    name = "form"

    def __init__(self, names: Callable[[], Iterable[str]]) -> None:
        self.names = names

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if value not in (names := tuple(self.names())):
            self.fail(f"'{value}' is none of {', '.join(names)}", param, ctx)
        return str(value)


class FormOption(click.Option):
    """An option that names a form; its help lists them."""

    def get_help_record(self, ctx: click.Context) -> tuple[str, str] | None:
        name, text = super().get_help_record(ctx) or ("", "")
        names = self.type.names() if isinstance(self.type, FormName) else ()
        return name, f"{text.rstrip('.')}: {', '.join(names)}."


def _exports() -> Iterable[str]:
    from imucalib.exports import exports

    return exports()


EXPORT_FORM = FormName(_exports)


def numbers_of(
    text: str, what: str, form: str, counts: Collection[int], least: float = -math.inf
) -> tuple[float, ...]:
    """ "1.5,0,-2" as finite numbers, one of some counts of them, none below the least; raises
    click's usage error, in which `form` says how they are written."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) not in counts or not all(least <= v < math.inf for v in found):
        raise click.BadParameter(f"'{text}' is not {form}", param_hint=what)
    return found


def row_numbers(text: str, what: str) -> tuple[int, ...]:
    """ "1-20,25" as row numbers; raises click's usage error."""
    rows: list[int] = []
    for part in filter(None, (p.strip() for p in text.split(","))):
        first, dash, last = part.partition("-")
        try:
            low = int(first)
            rows += range(low, int(last) + 1) if dash else [low]
        except ValueError:
            said = f"'{part}' is not a row or a range such as 1-20"
            raise click.BadParameter(said, param_hint=what) from None
    return tuple(rows)


def pairs(texts: tuple[str, ...], what: str) -> dict[str, str]:
    """ "a=b,c=d" options as a dictionary; raises click's usage error."""
    found: dict[str, str] = {}
    for part in (p for text in texts for p in _PAIRS.split(text) if p.strip()):
        name, sign, value = part.partition("=")
        if not sign:
            raise click.BadParameter(f"'{part}' is not of the form name=value", param_hint=what)
        found[name.strip()] = value.strip()
    return found


#: Heading -> options, by parameter name, that a help longer than a page leaves to --help-all.
_RARE = {
    "Reading a recording": f"{' '.join(name for name in READING if name != 'unit')} shortest_rest",
    "Angles and rows of a table": "gravity_sign z_axis inclination_zero toolface_zero_axis "
    "toolface_sense toolface_offset angle_unit swap_angles keep_angles axes swaps moves shifts",
    "Fit and search": "train model objective sigma as_published arithmetic loop curves seed height "
    "effects_file fleet without",
    "Posterior of an array": "as_drawn samples ess iterations save_draws accept_mm "
    "accept_mg accept_dps",
    "Limits": "max_inclination_error max_toolface_error max_norm_error max_worst_error "
    "max_gyro_error max_position_sd fail_on",
    "Studies": "entry",
}
RARE = {heading: tuple(names.split()) for heading, names in _RARE.items()}
_HEADING = {name: heading for heading, names in RARE.items() for name in names}


def _show_all(ctx: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted and not ctx.resilient_parsing:
        ctx.meta[_WHOLE_HELP] = True
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


def no_limit(command: click.Command, name: str) -> str:
    """That a command has no such limit, and which it has."""
    own = [
        p.opts[0] for p in command.params if (getattr(p, "help", "") or "").startswith(LIMIT_HELP)
    ]
    there = f"there are {', '.join(own)}" if own else "it has none"
    return f"imucal {command.name} has no limit {name}; {there}"


class PagedCommand(click.Command):
    """A command whose help, where it is longer than a page, leaves rare options to --help-all."""

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        return [*super().get_params(ctx), _HELP_ALL]

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """As click has it; a limit of another command is refused with those of this one."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            if not error.option_name.startswith(_LIMIT):
                raise
            raise click.UsageError(no_limit(self, error.option_name), ctx) from None

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        options = [p for p in self.get_params(ctx) if isinstance(p, click.Option)]
        shown = [(p, record) for p in options if (record := p.get_help_record(ctx))]
        whole = [record for parameter, record in shown if parameter is not _HELP_ALL]
        if self._fits(ctx, whole):
            _write(formatter, "Options", whole)
            return
        by_heading: dict[str, Records] = {name: [] for name in ("Options", *RARE)}
        for parameter, record in shown:
            by_heading[_HEADING.get(str(parameter.name), "Options")].append(record)
        _write(formatter, "Options", by_heading.pop("Options"))
        rare = {heading: records for heading, records in by_heading.items() if records}
        if ctx.meta.get(_WHOLE_HELP):
            for heading, records in rare.items():
                _write(formatter, heading, records)
        else:
            formatter.write_paragraph()
            count = sum(map(len, rare.values()))
            what = ", ".join(heading.lower() for heading in rare)
            formatter.write_text(f"{ctx.command_path} --help-all: {count} more options ({what}).")

    def _fits(self, ctx: click.Context, whole: Records) -> bool:
        """Whether the whole help is a page, whatever the terminal's width."""
        page = click.HelpFormatter(width=78)
        self.format_usage(ctx, page)
        self.format_help_text(ctx, page)
        _write(page, "Options", whole)
        self.format_epilog(ctx, page)
        return page.getvalue().count("\n") <= PAGE


def _write(formatter: click.HelpFormatter, heading: str, records: Records) -> None:
    with formatter.section(heading):
        formatter.write_dl(records)


def command_with_page(
    name: str, cls: type[click.Command] = PagedCommand, short_help: str | None = None
) -> Callable[[Callable[..., int]], click.Command]:
    """A command of a function."""
    return click.command(name, cls=cls, short_help=short_help)
