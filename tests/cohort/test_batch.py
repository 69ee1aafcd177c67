"""Cohorts: each recording gets its entry, a bad one stops nothing, a rerun does what is missing."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.simulation import BenchPlan, simulated_recording, simulated_table
from imucalib.cohort.batch import plan, read_entry, read_manifest, run_task
from imucalib.errors import UnreadableInput
from imucalib.writers import write
from worlds.command import run

ARGUMENTS = ("--reference", "norm", "--no-loop")


@pytest.fixture(scope="module")
def cohort(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three good recordings, one truncated, one empty, one in a unit that cannot be."""
    folder = tmp_path_factory.mktemp("cohort")
    for k in range(3):
        rng = np.random.default_rng(k)
        table = simulated_table(BenchPlan("rings", 16), rng)
        write(simulated_recording(table, rng, rate=50.0, rest=3.0), folder / f"good{k}.csv")
    text = (folder / "good0.csv").read_text().splitlines(keepends=True)
    (folder / "short.csv").write_text("".join(text[:40]))
    (folder / "empty.csv").write_text("")
    scaled = [text[0], text[1], *(_scaled(line) for line in text[2:])]
    (folder / "unit.csv").write_text("".join(scaled))
    names = sorted(p.name for p in folder.glob("*.csv"))
    (folder / "cohort.txt").write_text("# recordings\n" + "\n".join(names) + "\n")
    return folder


def _scaled(line: str) -> str:
    t, *values = line.strip().split(",")
    return ",".join([t, *(str(37.0 * float(v)) for v in values)]) + "\n"


def batch(cohort: Path, out: Path, *options: str) -> dict:
    result = run("batch", cohort / "cohort.txt", "-o", out, "--calibrator", "lab", "--json", "-q",
                 *options, "--", *ARGUMENTS)  # fmt: skip
    assert result.exception is None, result.exception
    return json.loads(result.stdout) | {"exit": result.return_value}


@pytest.mark.slow
def test_bad_recordings_are_reported_and_the_rest_is_done(cohort: Path, tmp_path: Path) -> None:
    summary = batch(cohort, tmp_path / "out", "--jobs", "2")
    assert summary["exit"] == 3
    assert summary["calibrated"] == 3
    failed = {Path(f["recording"]).name: f["error"] for f in summary["failed"]}
    assert set(failed) == {"short.csv", "empty.csv", "unit.csv"}
    assert "empty" in failed["empty.csv"]
    again = batch(cohort, tmp_path / "out")
    assert again["reused"] == 6

    table = tmp_path / "cohort.csv"
    assert run("collect", tmp_path / "out", "-o", table, "-q").return_value == 0
    rows = {Path(r["recording"]).name: r for r in csv.DictReader(table.open())}
    assert len(rows) == 6
    assert rows["empty.csv"]["status"] == "unreadable"
    assert float(rows["good1.csv"]["held_out_final"]) < float(rows["good1.csv"]["error_raw"])
    assert float(rows["good1.csv"]["bias_x_sd"]) > 0.0


@pytest.mark.slow
def test_a_killed_batch_is_finished_by_a_rerun(cohort: Path, tmp_path: Path) -> None:
    undisturbed = batch(cohort, tmp_path / "calm")
    command = [sys.executable, "-m", "imucalib", "batch", str(cohort / "cohort.txt"), "-o",
               str(tmp_path / "hit"), "--calibrator", "lab", "-q", "--", *ARGUMENTS]  # fmt: skip
    process = subprocess.Popen(command, start_new_session=True)
    while not list((tmp_path / "hit").glob("*.json")) and process.poll() is None:
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    rerun = batch(cohort, tmp_path / "hit")
    assert rerun["calibrated"] == undisturbed["calibrated"] == 3
    assert rerun["reused"] >= 1
    for calm in (tmp_path / "calm").glob("*.json"):
        one, two = read_entry(calm), read_entry(tmp_path / "hit" / calm.name)
        assert one is not None
        assert two is not None
        for entry in (one, two):
            if entry.report:
                entry.report["provenance"].pop("time")
        assert (one.report, one.exit_code, one.key) == (two.report, two.exit_code, two.key)


@pytest.mark.slow
def test_other_settings_or_content_are_done_again(cohort: Path, tmp_path: Path) -> None:
    recording = tmp_path / "one.csv"
    recording.write_bytes((cohort / "good0.csv").read_bytes())
    (task,) = plan((recording,), tmp_path / "out", "lab", ARGUMENTS)
    (other,) = plan((recording,), tmp_path / "out", "lab", (*ARGUMENTS, "--gravity", "9.81"))
    assert not run_task(task).reused
    assert run_task(task).reused
    assert not run_task(task, resume=False).reused
    assert not run_task(other).reused
    recording.write_bytes((cohort / "good1.csv").read_bytes())
    assert not run_task(other).reused


def test_manifests(tmp_path: Path) -> None:
    path = tmp_path / "cohort.csv"
    path.write_text("subject,path\n7,a.csv\n8,b.csv\n")
    assert [p.name for p in read_manifest(path)] == ["a.csv", "b.csv"]
    for text, words in (("# none\n", "names no recording"), ("a.csv\na.csv\n", "named twice")):
        path.write_text(text)
        with pytest.raises(UnreadableInput, match=words):
            read_manifest(path)


@pytest.mark.slow
def test_a_dask_cluster_gives_the_same(cohort: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
    ):
        summary = batch(cohort, tmp_path / "out", "--scheduler", cluster.scheduler_address)
    assert summary["calibrated"] == 3
