"""What every command that calibrates has: options, files, printing and exit code, defined once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.bench_file import from_file
from imucalib.cli.frame.output import emit_json, note, say, show, working
from imucalib.data import Data
from imucalib.errors import LimitBroken, UnnamedColumns
from imucalib.question import paste

if TYPE_CHECKING:
    from imucalib.calibration.outcome import Gate
    from imucalib.report.files import Report

#: Where the root command leaves the arguments that it was called with.
ARGUMENTS = "imucal.arguments"
#: What a clock says while it goes on.
_WORK = "calibrating"
#: Where `_finish` leaves the report of what was calibrated, and the calibration.
_CONTENT, _CALIBRATION = "imucal.content", "imucal.calibration"


class _Limit(click.Option):
    """What a result is held against."""


def limit_option(name: str, what: str) -> opt.Parameter:
    """An option whose breach is exit 1; `shared_fields` gives those that were stated."""
    return opt.option(name, opt.LIMIT_HELP + what, type=float, cls=_Limit)


_OPTIONS = opt.combine(
    [
        opt.gravity,
        opt.folder(
            "-o --output",
            "Folder for calibration.yaml, report.html and report.json.",
        ),
        opt.file(
            "--entry",
            "Entry for `imucal collect`, as `imucal batch` writes it, of a failure too.",
        ),
        opt.many(
            "--declare",
            "EFFECT",
            "Put an effect into the base model; of one IMU of an array: NAME@imu3.",
        ),
        opt.only,
        opt.without,
        opt.own_effects,
        opt.option("--loop/--no-loop", "Search for what the model lacks.", default=True),
        opt.option(
            "--curves/--no-curves",
            "Correct structure without a name by a smooth curve, where that holds out; "
            "default yes, of an array no.",
            default=None,
        ),
        limit_option(
            "--max-error", "held-out error, in the report's unit (mg; array: m/s²); exit 1 beyond."
        ),
        opt.choice(
            "--fail-on",
            "suspected unexplained caution",
            "End with exit 5 also where a name is not proved yet, structure has no name, "
            "or anything at all is cautioned.",
        ),
        opt.full,
        opt.option(
            "--export",
            "Write them for another program, too; see `imucal export`.",
            multiple=True,
            type=opt.EXPORT_FORM,
        ),
        opt.recording,
        opt.force,
        opt.json,
        opt.verbose,
        opt.quiet,
    ]
)


def calibrating(command: Callable[..., Sequence[Report]]) -> Callable[..., int]:
    """Make a command of what returns reports, with the options of those that calibrate.

    command : takes `say` beside its options, which says a line about the work; `shared_fields`
        reads what the shared options say of the request. Several reports go to folders of their
        own, by their names; one without a name among them, the last, is what all say as one
    """

    @functools.wraps(command)
    def checked(*args: Any, **options: Any) -> int:
        if options["export"] and options["output"] is None:
            raise click.UsageError("--export needs a folder: -o")
        if options["output"] is not None and not options["force"]:
            _demand_folders(options["output"], options)

        def work() -> int:
            with working(_WORK, quiet=options["quiet"], verbose=options["verbose"]) as say:
                reports = command(*args, say=say, **options)
            return _finish(reports, options)

        try:
            return work() if options["entry"] is None else _add_entry(work, options)
        except UnnamedColumns as error:  # of a table that another command may take
            file = paste(_inputs(options)[0])
            error.remedy += f"; imucal {file} says what else it may be"
            raise

    checked.calibrates = True  # type: ignore[attr-defined]
    found: Callable[..., int] = _OPTIONS(checked)
    return found


def is_calibrator(command: click.Command) -> bool:
    """Whether a command is a calibrating one."""
    return bool(getattr(command.callback, "calibrates", False))


def _add_entry(work: Callable[[], int], options: Mapping[str, Any]) -> int:
    """Do the work, and write what became of it as an entry of a cohort, a failure too, with the
    calibration beside it; but not that of the call itself, which says nothing about a recording."""
    import time

    from imucalib.atomic_file import demand_output
    from imucalib.cli.frame.failures import failure_of
    from imucalib.cohort.entries import calibration_beside, entry_of, failure_words, write_entry
    from imucalib.errors import CRASH_EXIT_CODE, ImucalError, UsageError

    recordings, target, start = _inputs(options), options["entry"], time.monotonic()
    for path in (target, calibration_beside(target)):
        demand_output(path, recordings, force=options["force"])

    def write(code: int, error: str, report: Mapping[str, Any] | None) -> None:
        name, seconds = str(recordings[0].absolute()), time.monotonic() - start
        made = click.get_current_context().meta.get(_CALIBRATION)
        write_entry(entry_of(name, code, seconds, error, report), target, made)

    try:
        code = work()
    except (UsageError, click.ClickException, click.Abort):
        raise
    except (ImucalError, OSError) as error:
        failure = failure_of(error)
        write(failure.exit_code, failure_words(failure.message, failure.remedy), None)
        raise
    except Exception as error:  # a study keeps what it was; the caller reports it as a crash
        write(CRASH_EXIT_CODE, f"{type(error).__name__}: {error}", None)
        raise
    write(code, "", click.get_current_context().meta[_CONTENT])
    return code


def _paths(values: Iterable[Any]) -> list[Path]:
    """The paths among the values of parameters, those of a repeated one each."""
    each = chain.from_iterable(v if isinstance(v, tuple) else (v,) for v in values)
    return [one for one in each if isinstance(one, Path)]


def _inputs(options: Mapping[str, Any]) -> list[Path]:
    """The files that the arguments name."""
    parameters = click.get_current_context().command.params
    return _paths(options[str(p.name)] for p in parameters if isinstance(p, click.Argument))


def _demand_folders(folder: Path, options: Mapping[str, Any]) -> None:
    """Refuse, before the work, a folder that cannot be written or that holds another's results."""
    from imucalib.report.files import demand_folder

    read = _inputs(options)
    folders = [folder, *(folder / each.stem for each in read if len(read) > 1)]
    for each in folders:
        demand_folder(each, [*read, *_paths(options.values())])


def shared_fields(options: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a calibrator's request that the shared options state; without `curves` where the
    calibrator's own default holds. Raises click's usage errors."""
    from imucalib.effects import load_file

    parameters = click.get_current_context().command.params
    limits = {
        limit.opts[0].removeprefix("--"): value
        for limit in parameters
        if isinstance(limit, _Limit) and (value := options[str(limit.name)]) is not None
    }
    for name, limit in limits.items():
        if not limit >= 0.0:
            raise click.BadParameter("a limit is zero or more", param_hint=f"--{name}")
    gravity, source = opt.gravity_of(options)
    return {
        "gravity": gravity,
        "gravity_source": source,
        **{name: options[name] for name in ("declare", "only", "without", "loop")},
        **({} if options["curves"] is None else {"curves": options["curves"]}),
        "extra_effects": load_file(options["effects_file"]) if options["effects_file"] else {},
        "limits": limits,
        "seed": options.get("seed", 0),
        "command": command_line(),
    }


def command_line() -> str:
    """The line that was typed, with what imucal.toml added, ready to be pasted; without the place
    of an entry, which is the study's and not the calibration's."""
    words = list(click.get_current_context().meta.get(ARGUMENTS, ()))
    if "--entry" in words:
        at = words.index("--entry")
        del words[at : at + 2]
    return paste("imucal", *words, *from_file())


class Logs(Data, name="logs/1"):
    """Reports of several logs, and of what they say as one."""

    logs: Annotated[tuple[Mapping[str, Any], ...], "A report each."]
    together: Annotated[Mapping[str, Any] | None, "A report."] = None


def _finish(reports: Sequence[Report], options: Mapping[str, Any]) -> int:
    """Write the files, print the result, and return the exit code; what several logs say as one
    above their folders, last, and as JSON under "together"."""
    every, output, several = [*reports], options["output"], len(reports) > 1
    together = several and not every[-1].name
    if options["fail_on"] is not None:
        every = [_gate(report, options["fail_on"]) for report in every]
    codes = [report.run.outcome.exit_code for report in every]
    if output is None:
        every = [_propose_output(report) for report in every]
    else:
        for k, report in enumerate(every):
            folder = output / report.name if several else output
            every[k] = _place(report, folder)
            codes.append(_write(every[k], folder, options))
    meta, run = click.get_current_context().meta, every[-1].run
    meta[_CONTENT], meta[_CALIBRATION] = every[-1].content, run.calibration
    if options["as_json"]:
        content = [report.content for report in every]
        whole = content.pop() if together else None
        emit_json(Logs(tuple(content), whole) if several else content[0])
    for report in every:
        outcome, said = report.run.outcome, tuple(filter(None, (report.run.outcome.gate_reason,)))
        if not (options["quiet"] or options["as_json"]):
            show(report.document, full=options["full"])
        elif options["quiet"] and outcome.exit_code:
            # Quiet hides what is fine; a pipeline that stops here must say why.
            said = (*outcome.broken, *map(str, outcome.undecided), *outcome.reasons, *said)
            said = said or (outcome.status,)
        if said:
            say(f"error: {outcome.provenance.input}: {'; '.join(said)}", err=True)
    return max(codes)


def _gate(report: Report, fail_on: Gate) -> Report:
    """The report of a run that fails on more than it has to."""
    outcome = report.run.outcome
    settings = {**outcome.provenance.settings, "fail_on": fail_on}
    made = replace(outcome.provenance, settings=settings)
    gated = replace(outcome, provenance=made, fail_on=fail_on)
    return replace(report, run=replace(report.run, outcome=gated))


def _place(report: Report, folder: Path) -> Report:
    """The report with its advice in terms of the files that are read and written."""
    source = report.run.outcome.provenance.input
    typed = click.get_current_context().params
    read = [*_inputs(typed), *_paths(v for name, v in typed.items() if name != "output")]
    given = next((path for path in read if path.name == source), read[0])
    places = {
        "calibration": str(folder / "calibration.yaml"),
        "folder": str(folder),
        "input": str(given),
        "reading": opt.repeat_typed(without=("sensor",)),
        "suffix": next((s for s in (".csv", ".h5") if s in given.suffixes), ".mcap"),
    }
    return replace(report, document=report.document.place_commands(places))


def _propose_output(report: Report) -> Report:
    """The report with what writes it, into a folder that is not there yet."""
    names = chain(["out"], (f"out_{k}" for k in count(2)))
    folder = next(name for name in names if not Path(name).exists())
    command = report.run.outcome.provenance.command
    return replace(report, document=report.document.propose_writing(f"{command} -o {folder}"))


def _write(report: Report, folder: Path, options: Mapping[str, Any]) -> int:
    """The files; the exit code of forms that were not written since they lose too much."""
    from imucalib.exports import demand_carried, export
    from imucalib.report.files import write_report

    run, made, refused = report.run, [], []
    fit = run.outcome.fit
    for name in options["export"] if fit is None or fit.converged else ():
        one = export(run.calibration, run.outcome.provenance.input, name)
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
