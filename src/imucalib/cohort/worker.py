"""A process that keeps its interpreter: each command runs in a fork of it, by itself, with what the
commands before had to import. It is asked on its stdin and answers on its stdout, a line of JSON
each: `imucalib.cli.batch.serve`."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

#: One BLAS thread: recordings are what is done at once.
_THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"), "1")
_SERVE = "from imucalib.cli import main; from imucalib.cli.batch import serve; serve(main)"


class Worker:
    """Runs commands, one after the other, each in a process of its own."""

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
