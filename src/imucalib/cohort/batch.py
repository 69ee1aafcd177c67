"""Cohorts: one recording a task, each in a process of its own, on any concurrent.futures executor.

A task runs the command on one recording and writes one JSON entry, whole or not at all. The
entry's key is the content of the recording and of every file that takes part, and the settings, so
a rerun does only what is missing or has changed, and nothing that one recording does (a crash, lack
of memory) reaches another.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from imucalib.cohort.entries import Entry, calibration_beside, read_entry, write_entry
from imucalib.errors import UnreadableInput, UsageError
from imucalib.file_hash import sha256_of

#: Formats that a corrected recording keeps; others become a table.
_KEPT = (".h5", ".hdf5", ".mcap")
#: The worker of a thread.
_OWN = threading.local()
#: s between two looks at the workers.
_LOOK = 2.0
#: One BLAS thread: recordings are what is done at once.
_THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
_SERVE = "from imucalib.cli import main; from imucalib.cli.batch import serve; serve(main)"


class Worker:
    """A process that keeps its interpreter: each command runs in a fork of it, by itself, with what
    the commands before had to import. It is asked on its stdin and answers on its stdout, a line of
    JSON each: `imucalib.cli.batch.serve`."""

    def __init__(self, serve: str = _SERVE) -> None:
        """serve : what Python runs there"""
        self._serve = serve
        self._process: subprocess.Popen[str] | None = None

    def run(self, words: Sequence[str], folder: Path) -> tuple[int, str]:
        """Exit code, negative of a signal, and stderr of a command, called in a folder."""
        if not hasattr(os, "fork"):  # Windows
            return _run_once(words, folder)
        if self._process is None or self._process.poll() is not None:
            self._process = subprocess.Popen(
                [sys.executable, "-c", self._serve],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                env={**os.environ, **_THREADS},
                cwd=folder,
            )
        asked, answers = self._process.stdin, self._process.stdout
        assert asked is not None and answers is not None  # noqa: PT018
        with suppress(BrokenPipeError):
            asked.write(json.dumps([*words, str(folder)]) + "\n")
            asked.flush()
        answer = answers.readline()
        if not answer:  # it was killed itself
            return self._process.wait(), ""
        code, said = json.loads(answer)
        return int(code), str(said)

    def __del__(self) -> None:
        if self._process is not None:
            with suppress(Exception):
                self._process.communicate()  # the end of its stdin ends it


def _run_once(words: Sequence[str], folder: Path) -> tuple[int, str]:
    done = subprocess.run(
        [sys.executable, "-m", "imucalib", *words],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **_THREADS},
        stdin=subprocess.DEVNULL,
        cwd=folder,
    )
    return done.returncode, done.stderr


@dataclass(frozen=True)
class Task:
    """One recording to calibrate: the command's arguments and where its entry goes.

    files : those of the arguments that name a file
    corrected : where the recording goes corrected, or empty
    """

    recording: str
    entry: str
    calibrator: str
    arguments: tuple[str, ...]
    files: frozenset[str] = frozenset()
    corrected: str = ""

    @property
    def settings_key(self) -> str:
        """Digest of everything but the recording's content: of a file's, not of its place."""
        from imucalib import __version__

        words = [content_of(Path(a)) if a in self.files else a for a in self.arguments]
        text = json.dumps([__version__, self.calibrator, *words])
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def content_of(path: Path) -> str:
    """Digest of a file's content, or of a folder's files and their names."""
    if path.is_dir():
        parts = [
            (p.relative_to(path).as_posix(), content_of(p))
            for p in sorted(path.rglob("*"))
            if p.is_file()
        ]
        return hashlib.sha256(json.dumps(parts).encode()).hexdigest()
    try:
        return sha256_of(path)
    except UnreadableInput:
        return "unreadable"


def plan(
    recordings: tuple[Path, ...],
    folder: Path,
    calibrator: str,
    arguments: tuple[str, ...],
    shard: tuple[int, int] = (1, 1),
    files: frozenset[str] = frozenset(),
    corrected: Path | None = None,
) -> tuple[Task, ...]:
    """The tasks of one shard (i of n, from 1). Raises UsageError for an impossible shard.

    folder : of the entries, made absolute: a worker elsewhere is in another one
    corrected : folder of the corrected recordings, where these are asked for
    """
    index, count = shard
    if not 1 <= index <= count:
        raise UsageError(f"shard {index}/{count} does not exist", remedy="give i/n, i from 1 to n")
    tasks = []
    alone = Counter(path.name for path in recordings)
    for path in recordings[index - 1 :: count]:
        # Two folders may hold files of the same name: the path makes the entry's name unique.
        digest = hashlib.sha256(str(path).encode()).hexdigest()[:8]
        entry = folder.absolute() / f"{path.name}.{digest}.json"
        target = ""
        if corrected is not None:
            suffix = next((s for s in _KEPT if s in path.suffixes), ".csv")
            stem = path.name.partition(".")[0] + (f".{digest}" if alone[path.name] > 1 else "")
            target = str(corrected.absolute() / f"{stem}{suffix}")
        tasks.append(Task(str(path), str(entry), calibrator, arguments, files, target))
    return tuple(tasks)


def run_task(task: Task, *, resume: bool = True) -> Entry:
    """Calibrate one recording in a process of its own and write its entry. Never raises for it."""
    key, path = f"{content_of(Path(task.recording))}-{task.settings_key}", Path(task.entry)
    known = read_entry(path) if resume else None
    # What a signal ended (lack of memory, Ctrl-C) says nothing about the recording.
    if known is not None and known.key == key and known.exit_code >= 0:
        _correct(task, known)
        return replace(known, reused=True)
    path.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".", dir=path.parent) as place:
        own = Path(place) / "entry.json"
        words = (task.calibrator, task.recording, *task.arguments, "--entry", str(own), "--quiet")
        code, text = _run(task, words)
        made = read_entry(own)
        if made is None:  # it was killed, or is no recording for these options
            said = text.strip().removeprefix("error: ") or f"ended by {code}"
            made = Entry(task.recording, key, code, 0.0, said)
        calibration_beside(path).unlink(missing_ok=True)
        if calibration_beside(own).exists():
            os.replace(calibration_beside(own), calibration_beside(path))
        entry = replace(made, recording=task.recording, key=key)
        write_entry(entry, path)
    _correct(task, entry)
    return entry


def _correct(task: Task, entry: Entry) -> None:
    """Write the corrected recording, where it is asked for, not there yet, and nothing speaks
    against the calibration."""
    if not task.corrected or entry.exit_code or os.path.exists(task.corrected):
        return
    calibration = str(calibration_beside(Path(task.entry)))
    Path(task.corrected).parent.mkdir(parents=True, exist_ok=True)
    _run(task, ("apply", calibration, task.recording, "-o", task.corrected, "--quiet"))


def _run(task: Task, words: Sequence[str]) -> tuple[int, str]:
    """A command in a process of its own: exit code, and what it says on stderr. It sees no
    imucal.toml but the caller's, which is in the arguments."""
    if not hasattr(_OWN, "worker"):
        _OWN.worker = Worker()
    worker: Worker = _OWN.worker
    return worker.run(words, Path(task.entry).parent)


@dataclass
class Cluster:
    """Workers elsewhere.

    executor : where tasks are run
    workers : how many there are, which may raise OSError
    address : of their scheduler
    patience : s that a run without a worker waits for one
    alone : when it was first seen without one
    """

    executor: Executor
    workers: Callable[[], int]
    address: str
    patience: float
    alone: float | None = None

    def why_given_up(self, say: Callable[[str], None]) -> str:
        """Why nothing more will come, or empty. say : is given a line where no worker is there"""
        try:
            count, lost, start = self.workers(), "no worker", f"dask worker {self.address}"
        except OSError:
            count, lost, start = 0, "no scheduler", "dask scheduler"
        if count:
            self.alone = None
            return ""
        if self.alone is None:
            self.alone = time.monotonic()
            wait = f"waits {self.patience:g} s: --wait"
            say(f"{lost} at {self.address}; start one: {start} ({wait})")
        if time.monotonic() - self.alone < self.patience:
            return ""
        return f"{lost} was left at {self.address}. Start one and run the same command again"


def run_all(
    tasks: tuple[Task, ...],
    cluster: Cluster | None,
    jobs: int,
    *,
    resume: bool,
    say: Callable[[str], None],
) -> Iterator[Entry]:
    """Run tasks as they come, yielding each entry when it is done.

    cluster : where to run; None for `jobs` local processes at a time; say : is given a line where
    no worker is there. What no worker was left for ends as an entry that is not written.
    """
    # A local thread waits for one process.
    pool = ThreadPoolExecutor(max(jobs, 1)) if cluster is None else cluster.executor
    futures: dict[Future[Entry], Task] = {
        pool.submit(run_task, task, resume=resume): task for task in tasks
    }
    waiting = set(futures)
    try:
        while waiting:
            done, waiting = wait(waiting, _LOOK if cluster else None, FIRST_COMPLETED)
            for future in done:
                yield _ended(future, futures.pop(future))
            if cluster and waiting and (why := cluster.why_given_up(say)):
                for future in waiting:
                    future.cancel()
                    yield _lost(futures[future], why)
                return
    finally:
        if cluster is None:
            pool.shutdown(wait=False, cancel_futures=True)  # else a stopped run does all the rest


def _ended(future: Future[Entry], task: Task) -> Entry:
    if future.cancelled():
        return _lost(task, "the scheduler dropped it. Run the same command again")
    failure = future.exception()
    return future.result() if failure is None else _lost(task, f"the worker failed: {failure}")


def _lost(task: Task, why: str) -> Entry:
    """Of a worker that died with its task: no entry is written, a rerun does it again."""
    return Entry(task.recording, "", UnreadableInput.exit_code, 0.0, why)
