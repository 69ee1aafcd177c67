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

pytestmark = pytest.mark.slow
SAMPLES = Path(__file__).parents[2] / "sample_logs"
TABLE = SAMPLES / "paper_table_1.csv"
OPTIONS = ["--gravity", "9.8061", "--fix", "10:y=-58593"]
#: What says where and when, not what.
BESIDE = {"provenance", "card", "command", "notes"}


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


@pytest.mark.slow
@pytest.mark.parametrize("environment", [{"PYTHONHASHSEED": "7"}, {"OPENBLAS_NUM_THREADS": "2"}])
def test_the_process_decides_nothing(
    environment: dict[str, str], usual: dict[str, Any], tmp_path: Path
) -> None:
    same(usual, report(TABLE, tmp_path, **environment))


@pytest.mark.slow
def test_the_order_of_the_columns_decides_nothing(usual: dict[str, Any], tmp_path: Path) -> None:
    lines = TABLE.read_text(encoding="utf-8").splitlines()
    notes = [line for line in lines if line.startswith("#")]
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    order = random.Random(1).sample(range(len(rows[0])), len(rows[0]))
    moved = [",".join(row[k] for k in order) for row in rows]
    table = tmp_path / TABLE.name
    table.write_text("\n".join([*notes, *moved]) + "\n", encoding="utf-8")
    same(usual, report(table, tmp_path / "out"))


def shuffled(source: Path, target: Path, seed: int | None, *, timed: bool = False) -> None:
    """The table's rows in another order (None: as they are), on request with the second at which
    each was read."""
    lines = source.read_text(encoding="utf-8").splitlines()
    notes = [line for line in lines if line.startswith("#")]
    head, *rows = [line for line in lines if not line.startswith("#")]
    if timed:
        head, rows = f"{head},time_s", [f"{row},{60 * k}" for k, row in enumerate(rows)]
    moved = rows if seed is None else random.Random(seed).sample(rows, len(rows))
    target.write_text("\n".join([*notes, head, *moved]) + "\n", encoding="utf-8")


#: What a report says of the sensor, not row by row.
OF_ALL = ("status", "reasons", "parameters", "covariance", "loop", "held_out", "noise", "matrices")


def of_all(found: dict[str, Any]) -> dict[str, Any]:
    return {key: found[key] for key in OF_ALL}


def sensor(found: dict[str, Any]) -> dict[str, Any]:
    """The verdict and the numbers; drifts and steps in another order are other candidates."""
    loop = found["loop"]
    steps = [{"effect": s["effect"], "verdict": loop["verdict"]} for s in loop["steps"]]
    return {**of_all(found), "loop": {"steps": steps, "errors": loop["errors"]}}


@pytest.mark.slow
def test_the_order_of_the_rows_decides_nothing_of_norms(tmp_path: Path) -> None:
    """Where it stands clear of chance; what follows the order is another rival, which moves what is
    told by a fifth of what is left open at most."""
    source, options = SAMPLES / "cave_fb.csv", ["--reference", "norm"]
    usual = sensor(report(source, tmp_path / "usual", options))
    assert usual["loop"]["steps"]
    for seed in (1, 2):
        table = tmp_path / source.name
        shuffled(source, table, seed)
        other = sensor(report(table, tmp_path / str(seed), options))
        steps = [[s["effect"] for s in one["loop"]["steps"]] for one in (usual, other)]
        assert steps[0] == steps[1]
        for one, two in zip(usual["parameters"], other["parameters"], strict=True):
            assert abs(one["value"] - two["value"]) < 0.2 * one["sd"]


@pytest.mark.slow
def test_a_time_column_says_the_order_and_rows_keep_their_numbers(tmp_path: Path) -> None:
    found = []
    for seed in (None, 1):
        table = tmp_path / f"{seed}" / TABLE.name
        table.parent.mkdir()
        shuffled(TABLE, table, seed, timed=True)
        order = list(range(1, 33)) if seed is None else random.Random(seed).sample(range(1, 33), 32)
        fix = f"{order.index(10) + 1}:y=-58593"
        out = report(table, table.parent / "out", ["--gravity", "9.8061", "--fix", fix])
        found.append(of_all(out))
    same(*found)


@pytest.mark.slow
def test_an_order_that_is_none_is_told(usual: dict[str, Any], tmp_path: Path) -> None:
    """Where neighbours are taken to share a setting, another order is another model."""
    table = tmp_path / TABLE.name
    shuffled(TABLE, table, 1)
    options = ["--gravity", "9.8061", "--no-loop"]
    assert any("no order of work" in note for note in report(table, tmp_path, options)["notes"])
    assert not any("order of work" in note for note in usual["notes"])
