"""The same data give the same numbers: whatever the hash seed, threads or order of columns."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.slow
SAMPLES = Path(__file__).parents[2] / "sample_logs"
TABLE = SAMPLES / "paper_table_1.csv"
OPTIONS = ["--gravity", "9.8061", "--fix", "10:y=-58593"]
#: What says where and when, not what.
BESIDE = {"provenance", "card", "command", "notes"}


def report(table: Path, folder: Path, **environment: str) -> dict[str, Any]:
    """report.json of a run in a process of its own."""
    command = [sys.executable, "-m", "imucalib", "lab", str(table), *OPTIONS, "-o", str(folder)]
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", **environment}
    run = subprocess.run([*command, "--json", "--quiet"], env=env, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    assert isinstance(found, dict)
    return found


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number and word with its place."""
    if isinstance(node, dict):
        for key, value in node.items():
            if key not in BESIDE:
                yield from leaves(value, f"{path}/{key}")
    elif isinstance(node, list):
        for k, value in enumerate(node):
            yield from leaves(value, f"{path}/{k}")
    else:
        yield path, node


def same(one: dict[str, Any], two: dict[str, Any]) -> None:
    """To 1e-6, and every word."""
    first, second = dict(leaves(one)), dict(leaves(two))
    assert first.keys() == second.keys()
    for place, value in first.items():
        if isinstance(value, float):
            assert np.isclose(value, second[place], rtol=1e-6, atol=1e-9, equal_nan=True), place
        else:
            assert value == second[place], place


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return report(TABLE, tmp_path_factory.mktemp("usual"), PYTHONHASHSEED="0")


@pytest.mark.parametrize("environment", [{"PYTHONHASHSEED": "7"}, {"OPENBLAS_NUM_THREADS": "2"}])
def test_the_process_decides_nothing(
    environment: dict[str, str], usual: dict[str, Any], tmp_path: Path
) -> None:
    same(usual, report(TABLE, tmp_path, **environment))


def test_the_order_of_the_columns_decides_nothing(usual: dict[str, Any], tmp_path: Path) -> None:
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    notes = [line for line in lines if line.startswith("#")]
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    order = random.Random(1).sample(range(len(rows[0])), len(rows[0]))
    moved = [",".join(row[k] for k in order) for row in rows]
    table = tmp_path / TABLE.name
    table.write_text("\n".join([*notes, *moved]) + "\n", encoding="utf-8")
    same(usual, report(table, tmp_path / "out"))
