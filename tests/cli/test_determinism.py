"""The same data give the same numbers: whatever the hash seed, threads or order of columns."""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from worlds.places import SAMPLES

pytestmark = pytest.mark.slow
TABLE = SAMPLES / "paper_table_1.csv"
OPTIONS = ["--gravity", "9.8061", "--fix", "10:y=-58593"]
#: What says where and when, not what; of a table in another order, what says it row by row too.
BESIDE = {"provenance", "card", "command", "notes"}
BY_ROW = BESIDE | {"figures", "positions", "undecided", "left", "limits", "sessions"}


def report(
    table: Path, folder: Path, options: Sequence[str] = OPTIONS, **environment: str
) -> dict[str, Any]:
    """report.json of a run in a process of its own."""
    command = [sys.executable, "-m", "imucalib", "lab", str(table), *options, "-o", str(folder)]
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1", **environment}
    run = subprocess.run([*command, "--json", "--quiet"], env=env, capture_output=True, check=False)
    assert run.returncode in (0, 5), run.stderr
    found = json.loads(run.stdout)
    assert isinstance(found, dict)
    return found


def leaves(node: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every number and word with its place."""
    if isinstance(node, dict | list):
        for key, value in node.items() if isinstance(node, dict) else enumerate(node):
            yield from leaves(value, f"{path}/{key}")
    else:
        yield path, node


def same(one: dict[str, Any], two: dict[str, Any], beside: set[str] = BESIDE) -> None:
    """To 1e-6, and every word."""
    first, second = (
        dict(leaves({k: v for k, v in found.items() if k not in beside})) for found in (one, two)
    )
    assert first.keys() == second.keys()
    for place, value in first.items():
        if isinstance(value, float):
            assert np.isclose(value, second[place], rtol=1e-6, atol=1e-9, equal_nan=True), place
        else:
            assert value == second[place], place


def rearranged(
    source: Path,
    folder: Path,
    seed: int | None,
    *,
    columns: bool = False,
    timed: bool = False,
) -> Path:
    """The table with its rows or columns in another order (None: as they are), on request with the
    second at which each row was read."""
    lines = source.read_text(encoding="utf-8").splitlines()
    notes = [line for line in lines if line.startswith("#")]
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    if timed:
        rows = [[*row, f"{60 * k}" if k else "time_s"] for k, row in enumerate(rows)]
    if seed is not None and columns:
        order = random.Random(seed).sample(range(len(rows[0])), len(rows[0]))
        rows = [[row[k] for k in order] for row in rows]
    elif seed is not None:
        rows[1:] = random.Random(seed).sample(rows[1:], len(rows) - 1)
    folder.mkdir(exist_ok=True)
    target = folder / source.name
    target.write_text("\n".join([*notes, *map(",".join, rows)]) + "\n", encoding="utf-8")
    return target


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return report(TABLE, tmp_path_factory.mktemp("usual"), PYTHONHASHSEED="0")


@pytest.mark.parametrize("environment", [{"PYTHONHASHSEED": "7"}, {"OPENBLAS_NUM_THREADS": "2"}])
def test_the_process_decides_nothing(
    environment: dict[str, str], usual: dict[str, Any], tmp_path: Path
) -> None:
    same(usual, report(TABLE, tmp_path, **environment))


def test_the_order_of_the_columns_decides_nothing(usual: dict[str, Any], tmp_path: Path) -> None:
    table = rearranged(TABLE, tmp_path, 1, columns=True)
    same(usual, report(table, tmp_path / "out"))


def test_the_order_of_the_rows_decides_nothing_of_norms(tmp_path: Path) -> None:
    """Where it stands clear of chance; what follows the order is another rival, which moves what is
    said by a fifth of what is left open at most."""
    source, options = SAMPLES / "cave_fb.csv", ["--reference", "norm"]
    usual, *others = (
        report(rearranged(source, tmp_path, seed), tmp_path / str(seed), options)
        for seed in (None, 1, 2)
    )
    assert usual["loop"]["steps"]
    for other in others:
        steps = [[s["effect"] for s in one["loop"]["steps"]] for one in (usual, other)]
        assert steps[0] == steps[1]
        for one, two in zip(usual["parameters"], other["parameters"], strict=True):
            assert abs(one["value"] - two["value"]) < 0.2 * one["sd"]


def test_a_time_column_says_the_order_and_rows_keep_their_numbers(tmp_path: Path) -> None:
    found = []
    for seed in (None, 1):
        table = rearranged(TABLE, tmp_path / str(seed), seed, timed=True)
        order = list(range(1, 33)) if seed is None else random.Random(seed).sample(range(1, 33), 32)
        fix = f"{order.index(10) + 1}:y=-58593"
        found.append(report(table, table.parent / "out", ["--gravity", "9.8061", "--fix", fix]))
    same(*found, BY_ROW)


def test_an_order_that_is_none_is_told(usual: dict[str, Any], tmp_path: Path) -> None:
    """Where neighbours are taken to share a setting, another order is another model."""
    table = rearranged(TABLE, tmp_path, 1)
    notes = report(table, tmp_path / "out", ["--gravity", "9.8061", "--no-loop"])["notes"]
    assert any("no order of work" in note for note in notes)
    assert not any("order of work" in note for note in usual["notes"])
