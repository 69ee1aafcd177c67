"""What every command that calibrates has: options, files, printing and exit code, defined once."""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imucalib.cli.bench_file import taken
from imucalib.cli.options import (
    EXPORT_FORM,
    force_option,
    full_option,
    gravity_of,
    gravity_options,
    json_option,
    quiet_option,
    recording_options,
)
from imucalib.cli.output import (
    Command,
    Say,
    emit_json,
    note,
    say,
    show,
    verbose_option,
    working,
)
from imucalib.errors import LimitBroken

if TYPE_CHECKING:
    from imucalib.calibration.outcome import Gate
    from imucalib.core.effect import Effect
    from imucalib.report.files import Report

#: Where the root command leaves the arguments that it was called with.
ARGUMENTS = "imucal.arguments"
#: Where `finish` leaves the report of what was calibrated.
_CONTENT = "imucal.content"


class _Limit(click.Option):
    """What a result is held against."""


def limit_option(name: str, what: str) -> Callable[[Command], Command]:
    """An option whose breach is exit 1; `Shared.limits` holds those that were given."""
    return click.option(name, type=float, cls=_Limit, help=f"Limit: {what}")


_OPTIONS = (
    click.option(
        "-o",
        "--output",
        type=click.Path(path_type=Path, file_okay=False),
        help="Folder for calibration.yaml, report.html and report.json.",
    ),
    click.option(
        "--entry",
        type=click.Path(path_type=Path, dir_okay=False),
        help="Entry for `imucal collect`, as `imucal batch` writes it, of a failure too.",
    ),
    click.option(
        "--declare",
        multiple=True,
        metavar="EFFECT",
        help="Put an effect into the base model; of one IMU of an array: NAME@imu3.",
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
    click.option(
        "--loop/--no-loop", default=True, show_default=True, help="Search for what the model lacks."
    ),
    click.option(
        "--curves/--no-curves",
        default=None,
        help="Correct structure without a name by a smooth curve, where that holds out; "
        "default yes, of an array no.",
    ),
    limit_option(
        "--max-error", "held-out error, in the report's unit (mg; array: m/s²); exit 1 beyond."
    ),
    click.option(
        "--fail-on",
        type=click.Choice(["suspected", "unexplained", "caution"]),
        help="End with exit 5 also where a name is not proved yet, structure has no name, "
        "or anything at all is cautioned.",
    ),
    full_option,
    click.option(
        "--export",
        multiple=True,
        type=EXPORT_FORM,
        help="Write them for another program, too; see `imucal export`.",
    ),
)


def calibrating(command: Command) -> Command:
    """Add the options of a calibrating command and mark it as one.

    `shared_of` reads their values, `finish` does what they ask once the run is there.
    """

    @functools.wraps(command)
    def checked(*args: Any, **options: Any) -> Any:
        if options["export"] and options["output"] is None:
            raise click.UsageError("--export needs a folder: -o")
        if options["output"] is not None and not options["force"]:
            _demand_folders(options["output"], options)
        if options["entry"] is None:
            return command(*args, **options)
        return _with_entry(functools.partial(command, *args, **options), options)

    checked.calibrates = True  # type: ignore[attr-defined]
    whole: Any = checked
    for option in (quiet_option, verbose_option, json_option, force_option):
        whole = option(whole)
    whole = recording_options(whole)
    for option in reversed(_OPTIONS):
        whole = option(whole)
    found: Command = gravity_options(whole)
    return found


def _with_entry(work: Callable[[], int], options: Mapping[str, Any]) -> int:
    """Do the work, and write what became of it as an entry of a cohort, a failure too; but not that
    of the call itself, which says nothing about a recording."""
    import time

    from imucalib.atomic_file import demand_output
    from imucalib.cli import failure_of
    from imucalib.cohort.entries import Entry, failure_words, kept_of, write_entry
    from imucalib.errors import CRASH_EXIT_CODE, ImucalError, UsageError

    recordings, target, start = _inputs(options), options["entry"], time.monotonic()
    demand_output(target, recordings, force=options["force"])
    name = str(recordings[0].absolute())

    def write(code: int, error: str, report: Mapping[str, Any] | None) -> None:
        kept, seconds = kept_of(report) if report else None, time.monotonic() - start
        write_entry(Entry(name, "", code, seconds, error, kept), target)

    try:
        code = work()
    except (UsageError, click.ClickException, click.Abort):
        raise
    except (ImucalError, OSError) as error:
        failure = failure_of(error)
        write(failure["exit_code"], failure_words(failure), None)
        raise
    except Exception as error:  # a study keeps what it was; the caller reports it as a crash
        write(CRASH_EXIT_CODE, f"{type(error).__name__}: {error}", None)
        raise
    write(code, "", click.get_current_context().meta[_CONTENT])
    return code


def _inputs(options: Mapping[str, Any]) -> list[Path]:
    """The files that the arguments name."""
    context = click.get_current_context()
    arguments = [p.name for p in context.command.params if isinstance(p, click.Argument)]
    named = [options[name] for name in arguments if name is not None]
    return [Path(f) for value in named for f in (value if isinstance(value, tuple) else (value,))]


def _demand_folders(folder: Path, options: Mapping[str, Any]) -> None:
    """Refuse, before the work, a folder that cannot be written or that holds another's results."""
    from imucalib.report.files import demand_folder

    read = _inputs(options)
    others = [Path(v) for v in options.values() if isinstance(v, Path)]
    for each in (None, *read) if len(read) > 1 else (None,):
        demand_folder(folder / each.stem if each else folder, [*read, *others])


def calibrates(command: click.Command) -> bool:
    """Whether a command is a calibrating one."""
    return bool(getattr(command.callback, "calibrates", False))


def calibrating_of(options: Mapping[str, Any]) -> AbstractContextManager[Say]:
    """The work of a calibration: yields what says a line about it."""
    return working("calibrating", quiet=options["quiet"], verbose=options["verbose"])


@dataclass(frozen=True)
class Shared:
    """What the shared options ask. curves : None for the calibrator's own default"""

    gravity: float
    gravity_source: str
    declare: tuple[str, ...]
    only: tuple[str, ...]
    without: tuple[str, ...]
    loop: bool
    curves: bool | None
    extra_effects: Mapping[str, Effect]
    limits: Mapping[str, float]
    seed: int
    command: str


def shared_of(options: Mapping[str, Any]) -> Shared:
    """The values of the shared options. Raises click's usage errors."""
    from imucalib.effects import load_file

    asked = [p for p in click.get_current_context().command.params if isinstance(p, _Limit)]
    limits = {
        option.opts[0].removeprefix("--"): options[str(option.name)]
        for option in asked
        if options[str(option.name)] is not None
    }
    for name, limit in limits.items():
        if not limit >= 0.0:
            raise click.BadParameter("a limit is zero or more", param_hint=f"--{name}")
    gravity, source = gravity_of(options)
    return Shared(
        gravity=gravity,
        gravity_source=source,
        declare=options["declare"],
        only=options["only"],
        without=options["without"],
        loop=options["loop"],
        curves=options["curves"],
        extra_effects=load_file(options["effects_file"]) if options["effects_file"] else {},
        limits=limits,
        seed=options.get("seed", 0),
        command=command_line(),
    )


def command_line() -> str:
    """The line that was typed, with what imucal.toml added, ready to be pasted."""
    ctx = click.get_current_context()
    return shlex.join(["imucal", *ctx.meta.get(ARGUMENTS, ()), *taken(ctx)])


@dataclass(frozen=True)
class Together:
    """What several logs of one command say together: written above their folders, printed last, and
    as JSON under `name`."""

    name: str
    report: Report


def finish(
    reports: Sequence[Report], options: Mapping[str, Any], together: Together | None = None
) -> int:
    """Write the files, print the result, and return the exit code.

    Several reports go to folders of their own, named after their inputs.
    """
    reports = [_gated(report, options["fail_on"]) for report in reports]
    if together:
        together = replace(together, report=_gated(together.report, options["fail_on"]))
    every = [*reports, together.report] if together else reports
    codes = [report.run.outcome.exit_code for report in every]
    if options["output"] is not None:
        several = len(reports) > 1
        folders = [_folder(report, options, several) for report in reports]
        placed = [_placed(*one, options) for one in zip(reports, folders, strict=True)]
        codes += [_write(*one, options) for one in zip(placed, folders, strict=True)]
        reports = placed
        if together:
            codes.append(_write(together.report, options["output"], options))
    else:
        reports = [_unwritten(report) for report in reports]
    last = together.report if together else reports[-1]
    click.get_current_context().meta[_CONTENT] = last.content
    if options["as_json"]:
        contents = [report.content for report in reports]
        if together:
            emit_json({"logs": contents, together.name: together.report.content})
        else:
            emit_json(contents[0])
    elif not options["quiet"]:
        for report in reports:
            show(report.document, full=options["full"])
        if together:
            show(together.report.document, full=options["full"])
    return max(codes)


def _folder(report: Report, options: Mapping[str, Any], several: bool) -> Path:
    """Where a report's files go."""
    folder: Path = options["output"]
    return folder / Path(report.run.outcome.provenance.path).stem if several else folder


def _placed(report: Report, folder: Path, options: Mapping[str, Any]) -> Report:
    """The report with its advice in terms of the files that are read and written."""
    source = report.run.outcome.provenance.path
    given = next((p for p in _named(options) if p.name == source), Path(source))
    suffix = next((s for s in (".csv", ".h5") if s in given.suffixes), ".mcap")
    places = {
        "calibration": str(folder / "calibration.yaml"),
        "folder": str(folder),
        "input": str(given),
        "suffix": suffix,
    }
    return replace(report, document=report.document.placed(places))


def _named(options: Mapping[str, Any]) -> Iterator[Path]:
    """Every file that the line names."""
    for value in (*click.get_current_context().params.values(), *options.values()):
        for one in value if isinstance(value, tuple) else (value,):
            if isinstance(one, Path):
                yield one


def _unwritten(report: Report) -> Report:
    """The report with what writes it, into a folder that is not there yet."""
    names = chain(["out"], (f"out_{k}" for k in count(2)))
    folder = next(name for name in names if not Path(name).exists())
    command = report.run.outcome.provenance.command
    return replace(report, document=report.document.unwritten(f"{command} -o {folder}"))


def _gated(report: Report, fail_on: Gate | None) -> Report:
    """The report of a run that fails on more than it has to."""
    if fail_on is None:
        return report
    outcome = report.run.outcome
    settings = {**outcome.provenance.settings, "fail_on": fail_on}
    made = replace(outcome.provenance, settings=settings)
    gated = replace(outcome, provenance=made, fail_on=fail_on)
    return replace(report, run=replace(report.run, outcome=gated))


def _write(report: Report, folder: Path, options: Mapping[str, Any]) -> int:
    """The files; the exit code of forms that were not written since they lose too much."""
    from imucalib.exports import exported
    from imucalib.exports.bound import demand_carried
    from imucalib.report.files import write_report

    run, made, refused = report.run, [], []
    for name in options["export"]:
        one = exported(run.calibration, run.outcome.provenance.path, name)
        try:
            if not options["force"]:
                demand_carried(one, name, run.calibration, None)
            made.append(one)
        except LimitBroken as error:
            refused.append(error)
    for path in write_report(report, folder, made):
        note(f"wrote {path}", options["quiet"])
    for one in made:
        for text in one.lost:
            note(f"{one.file} lacks {text}", options["quiet"])
    for reason in refused:
        say(f"error: {reason}", err=True)
    return LimitBroken.exit_code if refused else 0
