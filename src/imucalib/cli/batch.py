"""imucal batch"""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path

import click

from imucalib.cli.options import PagedCommand, json_option, quiet_option
from imucalib.cli.output import emit_json, note, progress


@click.command(
    "batch",
    cls=PagedCommand,
    short_help="Calibrate a cohort, one recording a task.",
    context_settings={"ignore_unknown_options": True},
)
@click.argument("manifest", type=click.Path(path_type=Path))
@click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
@click.option(
    "-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder of the entries."
)
@click.option(
    "--calibrator", default="actigraph", show_default=True, help="Command to run on each recording."
)
@click.option("--jobs", default=1, show_default=True, help="Local processes at a time.")
@click.option(
    "--shard",
    default="1/1",
    show_default=True,
    metavar="I/N",
    help="Only every N-th recording, from the I-th.",
)
@click.option(
    "--resume/--no-resume",
    default=True,
    show_default=True,
    help="Keep entries whose recording and settings are unchanged.",
)
@click.option("--scheduler", help="Address of a Dask scheduler to run on (extra cluster).")
@json_option
@quiet_option
def command(
    manifest: Path,
    arguments: tuple[str, ...],
    output: Path,
    calibrator: str,
    jobs: int,
    shard: str,
    resume: bool,
    scheduler: str | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Calibrate all recordings of MANIFEST: a path a line, or a CSV with a column path.

    ARGUMENTS after -- go to the calibrator. One bad file never stops the rest; a rerun does only
    what is missing. `imucal collect` makes the table. Exit code 3 when a recording failed.

    \b
    Examples:
      imucal batch cohort.txt -o entries --jobs 4 -- --gravity 9.81
      imucal batch cohort.txt -o entries --shard $SLURM_ARRAY_TASK_ID/50
    """
    from imucalib.cohort.batch import plan, read_manifest, run_all

    recordings = read_manifest(manifest)
    index, slash, count = shard.partition("/")
    if not (slash and index.isdigit() and count.isdigit()):
        raise click.BadParameter(f"'{shard}' is not I/N", param_hint="--shard")
    tasks = plan(recordings, output, calibrator, arguments, (int(index), int(count)))
    entries, start = [], time.monotonic()
    with _workers(scheduler) as executor, progress(len(tasks), "recordings", quiet) as advance:
        for entry in run_all(tasks, executor, jobs, resume=resume):
            entries.append(entry)
            advance()
            if not entry.calibrated:
                note(f"{entry.recording}: {entry.error}", quiet)
    failed = [e for e in entries if not e.calibrated]
    summary = {
        "recordings": len(entries),
        "calibrated": len(entries) - len(failed),
        "reused": sum(e.reused for e in entries),
        "failed": [{"recording": e.recording, "error": e.error} for e in failed],
        "seconds": round(time.monotonic() - start, 1),
    }
    if as_json:
        emit_json(summary)
    elif not quiet:
        click.echo(
            f"{summary['calibrated']} of {summary['recordings']} calibrated "
            f"({summary['reused']} from before), {len(failed)} failed; entries in {output}"
        )
    return 3 if failed else 0


@contextmanager
def _workers(address: str | None) -> Iterator[Executor | None]:
    """The executor of a Dask cluster, or None for local processes."""
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
    with client:
        yield client.get_executor(retries=2)  # type: ignore[no-untyped-call]
