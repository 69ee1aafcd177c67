"""A worker: a command is a process of its own, and has what those before it had to import."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from imucalib.cohort.batch import Worker

SERVE = """
import os, sys
from imucalib.cli.batch import serve
def run():
    if sys.argv[1] == "die":
        os.kill(os.getpid(), 9)
    print(sys.argv[1], "colorsys" in sys.modules, os.getcwd(), file=sys.stderr)
    import colorsys
    sys.exit(5)
serve(run)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is kept there")
def test_what_was_imported_stays_and_what_dies_takes_nothing_with_it(tmp_path: Path) -> None:
    worker = Worker(SERVE)
    assert worker.run(["one"], tmp_path) == (5, f"one False {tmp_path}\n")
    assert worker.run(["die"], tmp_path) == (-9, "")
    assert worker.run(["two"], tmp_path) == (5, f"two True {tmp_path}\n")
