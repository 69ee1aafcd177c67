"""imucal batch: Calibrate a cohort, one recording a task.

imucal collect: Make one table of a cohort's entries.
"""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from imucalib.cli.frame import options as opt
from imucalib.cli.frame.output import note, progress, tell
from imucalib.data import Data
from imucalib.question import paste

if TYPE_CHECKING:
    from imucalib.cohort.batch import Cluster, Task
    from imucalib.cohort.entries import Entry

#: Where the command leaves the arguments after --.
_PASSED_ON = "imucal.passed_on"


class BatchCommand(opt.PagedCommand):
    """A command whose arguments behind -- are another's."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        at = args.index("--") if "--" in args else len(args)
        ctx.meta[_PASSED_ON] = tuple(args[at + 1 :])
        try:
            return super().parse_args(ctx, args[:at])
        except click.NoSuchOption as error:
            said = f"no option {error.option_name}; what is for the calibrator goes behind --"
            raise click.UsageError(said, ctx) from None


@opt.command_with_page("batch", cls=BatchCommand)
@click.argument("inputs", metavar="INPUT... [-- OPTIONS]", nargs=-1, required=True)
@opt.path("-o --output", "Folder of the entries.", required=True)
@opt.path("--corrected", "Write each recording corrected into FOLDER, where the exit code is 0.")
@opt.option("--calibrator", "Command to run on each recording.", default="actigraph")
@opt.option("--jobs", "Local processes at a time.", default=1)
@opt.option("--shard", "Only every N-th recording, from the I-th.", default="1/1", metavar="I/N")
@opt.option(
    "--resume/--no-resume",
    "Keep entries whose recording, files and settings are unchanged.",
    default=True,
)
@opt.option("--scheduler", "Address of a Dask scheduler to run on (extra cluster).")
@opt.option(
    "--wait",
    "With --scheduler: how long to wait while there is no worker.",
    default=60.0,
    type=click.FloatRange(min=0.0),
    metavar="SECONDS",
)
@opt.json
@opt.quiet
def command(inputs: tuple[str, ...], jobs: int, **options: Any) -> int:
    """Calibrate recordings, each by itself. An INPUT is a recording, a folder, a pattern such as
    'week*/*.cwa', or a manifest: a path a line, or a CSV with a column path.

    OPTIONS behind -- go to the calibrator. One bad file never stops the rest; a rerun does only
    what is missing. Each entry has its calibration beside it; `imucal collect` makes the table.
    Exit code 3 when a recording failed, or no worker was left for it.

    \b
    Examples:
      imucal batch recordings/ -o entries --jobs 4 -- --gravity 9.81
      imucal batch recordings/ -o entries --corrected corrected
      imucal batch cohort.txt -o entries --shard $SLURM_ARRAY_TASK_ID/50
    """
    from imucalib.cohort.batch import plan, run_all
    from imucalib.cohort.recordings import recordings_of

    output, calibrator, resume, quiet = (
        options[name] for name in ("output", "calibrator", "resume", "quiet")
    )
    passed, files = _options_of(calibrator, click.get_current_context().meta[_PASSED_ON])
    (recordings, said), shard = recordings_of(inputs), _shard_of(options["shard"])
    corrected = options["corrected"]
    tasks = plan(recordings, output, calibrator, passed, shard, files=files, corrected=corrected)
    failed: list[Entry] = []
    reused, start = 0, time.monotonic()
    with _workers(options["scheduler"], options["wait"]) as cluster:
        for line in (*said, _describe_plan(tasks, cluster, jobs, output, resume)):
            note(line, quiet)
        made = run_all(tasks, cluster, jobs, resume=resume, say=lambda text: note(text, quiet))
        with progress(len(tasks), "recordings", quiet) as advance:
            for entry in made:
                reused += entry.reused
                advance(entry.reused)
                if not entry.calibrated:
                    failed.append(entry)
                    if entry.key:
                        note(f"{entry.recording}: {entry.error}", quiet)
    for why, count in Counter(e.error for e in failed if not e.key).items():
        note(f"{count} recordings have no entry: {why}", quiet)
    return _summarize(len(tasks), reused, failed, time.monotonic() - start, options)


def _shard_of(text: str) -> tuple[int, int]:
    index, slash, count = text.partition("/")
    if not (slash and index.isdigit() and count.isdigit()):
        raise click.BadParameter(f"'{text}' is not I/N", param_hint="--shard")
    return int(index), int(count)


def _describe_plan(
    tasks: tuple[Task, ...], cluster: Cluster | None, jobs: int, folder: Path, resume: bool
) -> str:
    """What is about to be done, before the first recording is."""
    there = sum(os.path.exists(task.entry) for task in tasks) if resume else 0
    where = f"by the workers of {cluster.address}" if cluster else f"{max(jobs, 1)} at a time"
    kept = f" ({there} are there: kept where nothing has changed)" if there else ""
    name = tasks[0].calibrator if tasks else "nothing to do"
    return (
        f"imucal {name} on {len(tasks)} recordings, {where}; entries in {folder.absolute()}{kept}"
    )


class Failed(Data):
    """A recording without a calibration."""

    recording: str
    error: str


class Study(Data, name="batch/1"):
    """What became of the recordings of a cohort."""

    recordings: int
    calibrated: int
    reused: Annotated[int, "Of these, from before."]
    failed: tuple[Failed, ...]
    seconds: float


def _summarize(
    count: int, reused: int, failed: Sequence[Entry], seconds: float, options: dict[str, Any]
) -> int:
    summary = Study(
        recordings=count,
        calibrated=count - len(failed),
        reused=reused,
        failed=tuple(Failed(e.recording, e.error) for e in failed),
        seconds=round(seconds, 1),
    )
    gather = ("imucal", "collect", options["output"], "-o", "cohort.csv", "--html", "cohort.html")
    words = (
        f"{summary.calibrated} of {summary.recordings} calibrated "
        f"({reused} from before), {len(failed)} failed; entries in {options['output']}\n"
        f"the table: {paste(*gather)}"
    )
    tell(summary, options, words)
    return 3 if failed else 0


def _options_of(calibrator: str, typed: tuple[str, ...]) -> tuple[tuple[str, ...], frozenset[str]]:
    """The calibrator's options, those of imucal.toml first, and which of the words are files, by
    their absolute paths.

    Raises UsageError for what is no calibrator, and click's usage errors for options it lacks.
    """
    from imucalib.cli import calibrators, cli
    from imucalib.cli.frame.bench_file import defaults, from_file, sections
    from imucalib.errors import UsageError

    command = cli.get_command(click.Context(cli), calibrator)
    if command is None or calibrator not in calibrators():
        known = ", ".join(calibrators())
        raise UsageError(f"'{calibrator}' is no calibrator", remedy=f"use: {known}")
    stated = defaults(command, sections(Path.cwd()).get(calibrator, {}))
    context = command.make_context(calibrator, ["recording", *typed], default_map=stated)
    if context.params["output"] is not None:
        raise UsageError(
            "-o behind -- would be the folder of every recording",
            remedy="leave it out; imucal CALIBRATOR RECORDING -o gives the report of one",
        )
    with context:
        return _add_absolute_paths(command, [*from_file(), *typed])


def _add_absolute_paths(
    command: click.Command, words: list[str]
) -> tuple[tuple[str, ...], frozenset[str]]:
    """Options with absolute paths: a worker may stand in another folder."""
    paths = {name for p in command.params if isinstance(p.type, click.Path) for name in p.opts}
    out, files, before = list[str](), set[str](), ""
    for word in words:
        name, sign, value = word.partition("=")
        parts = [name, value] if sign and name.startswith("--") else [word]
        for part in parts:
            # A board is a file or a name.
            file = before in paths or (before.startswith("-") and os.path.isfile(part))
            if file and not part.startswith("-"):
                out.append(os.path.abspath(part))
                files.add(out[-1])
            else:
                out.append(part)
            before = part
    return tuple(out), frozenset(files)


@contextmanager
def _workers(address: str | None, patience: float) -> Iterator[Cluster | None]:
    """A Dask cluster, or None for local processes."""
    from imucalib.cohort.batch import Cluster
    from imucalib.errors import UsageError

    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        remedy = "pip install 'imucalib[cluster]'"
        raise UsageError("--scheduler needs Dask", remedy=remedy) from None
    try:
        client = Client(address)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        said = f"--scheduler: nothing answers at {address}"
        raise UsageError(said, remedy="start it, or correct the address") from error

    def workers() -> int:
        if client.status != "running":
            raise OSError(f"the connection to {address} is {client.status}")
        return len(client.nthreads())  # type: ignore[no-untyped-call]

    with client:
        executor = client.get_executor(retries=2)  # type: ignore[no-untyped-call]
        yield Cluster(executor, workers, address, patience)


def serve(run: Callable[[], None]) -> None:
    """Answer a `cohort.batch.Worker` until stdin ends: each command is a fork of this process.

    run : does what `sys.argv` says, and ends by SystemExit
    """
    import importlib
    import json
    from tempfile import TemporaryFile

    while request := sys.stdin.readline():
        *words, folder = json.loads(request)
        with TemporaryFile() as said, TemporaryFile() as loaded:
            child = os.fork()
            if child == 0:
                _become(run, words, folder, said.fileno(), loaded.fileno())
            code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
            said.seek(0)
            text = said.read().decode(errors="replace")
            loaded.seek(0)
            names = loaded.read().decode().split()
        os.write(1, f"{json.dumps([code, text])}\n".encode())
        for name in names:  # the next one begins with them
            with suppress(Exception):
                importlib.import_module(name)


def _become(
    run: Callable[[], None], words: Sequence[str], folder: str, said: int, loaded: int
) -> None:
    """Be the command; the process ends here, whatever happens."""
    code = 1
    try:
        before, nothing = set(sys.modules), os.open(os.devnull, os.O_RDWR)
        for end, place in enumerate((nothing, nothing, said)):
            os.dup2(place, end)
        os.chdir(folder)
        sys.argv = ["imucal", *words]
        try:
            run()
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else int(error.code is not None)
        sys.stderr.flush()
        new = [name for name in sys.modules if name not in before]
        os.write(loaded, "\n".join(new).encode(errors="replace"))
    finally:
        os._exit(code)


@opt.command_with_page("collect")
@click.argument("folder", type=opt.FOLDER)
@opt.path("-o --output", "Table to write: .csv, or .parquet (extra parquet).", required=True)
@opt.flag("--all-columns", "Every number of every report, not those of a paper.")
@opt.file("--html", "Page of all recordings, those to look at first.")
@opt.file("--ggir", "One file for GGIR, a row for each calibration that its form carries.")
@opt.force
@opt.quiet
def collect(folder: Path, output: Path, **options: Any) -> int:
    """Gather the entries that `imucal batch`, or --entry of a calibrator, wrote into one table, a
    row a recording: use it, use it with care, or do not, and why.

    \b
    Example: imucal collect entries -o cohort.csv --html cohort.html
    """
    from imucalib.calibration.file import write_whole
    from imucalib.cohort.entries import PAPER, cohort_of, rows, write_table
    from imucalib.errors import UnreadableInput
    from imucalib.report.cohort import cohort_html

    if not folder.is_dir():
        raise UnreadableInput(
            "no such folder", where=str(folder), remedy="name that of `imucal batch -o`"
        )
    html, ggir, quiet = (options[name] for name in ("html", "ggir", "quiet"))
    paths = sorted(folder.glob("*.json"), key=lambda path: path.stat().st_mtime)
    targets = [path for path in (output, html, ggir) if path is not None]
    opt.demand_outputs(options, targets, *paths)
    cohort = cohort_of(paths)
    if not cohort.newest:
        raise UnreadableInput(
            "no entries of a cohort in it",
            where=str(folder),
            remedy="`imucal batch MANIFEST -o FOLDER` writes them",
        )
    write_table(rows(cohort), output, cohort.columns if options["all_columns"] else PAPER)
    if html is not None:
        write_whole(html, cohort_html(rows(cohort), folder.absolute().name))
    for_ggir = _rows_for_ggir(cohort.newest.values(), quiet) if ggir is not None else []
    if ggir is not None:
        write_whole(ggir, "\n".join([*for_ggir, ""]))
    if cohort.others:
        note(f"{cohort.others} files are no entries", quiet)
    if cohort.older:
        note(f"{cohort.older} entries are older ones of the same recording", quiet)
    if not quiet:
        for target in targets:
            count = max(len(for_ggir) - 1, 0) if target == ggir else len(cohort.newest)
            click.echo(f"wrote {target}: {count} recordings")
    return 0


def _rows_for_ggir(entries: Iterable[Path], quiet: bool) -> list[str]:
    """Lines of one file for GGIR, its heading first; what has no row in it is told."""
    from imucalib.calibration.file import read
    from imucalib.cohort.entries import calibration_beside, read_entry
    from imucalib.errors import ImucalError
    from imucalib.exports import demand_carried, export

    lines: list[str] = []
    for entry, path in ((one, calibration_beside(one)) for one in entries):
        if (known := read_entry(entry)) and not known.calibrated:
            note(f"no row for GGIR: {path.stem}: not calibrated: {known.error}", quiet)
            continue
        try:
            calibration = read(path)
            recording = str(calibration.facts["provenance"]["input"])
            made = export(calibration, recording, "ggir-csv")
            demand_carried(made, "ggir-csv", calibration, None)
        except ImucalError as error:
            note(f"no row for GGIR: {path.stem}: {error.what}", quiet)
            continue
        lines += made.text.splitlines()[bool(lines) :]
    return lines
