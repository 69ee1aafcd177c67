"""Power-ups on one bench: what they share, what one has of its own, what the next will be."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun
from imucalib.calibrators.lab.simulation import BenchPlan, simulate_recording, simulate_table
from imucalib.errors import UnreadableInput, UsageError
from imucalib.file_hash import sha256_of
from imucalib.writers import write as write_recording

HEADER = ("session", "inclination", "tool_face", "x (mg)", "y (mg)", "z (mg)")
SETTINGS = [(i, t + i / 2.0) for i in (-60.0, -20.0, 20.0, 60.0) for t in (0.0, 90.0, 180.0, 270.0)]
REQUEST = LabRequest(loop=False)


def rows_of(bias: np.ndarray, turn: np.ndarray, seed: int = 0, noise: float = 0.2) -> list[tuple]:
    """A table of some sessions by plain numpy. bias : (s, 3) mg; turn : (s, 3) deg"""
    rng = np.random.default_rng(seed)
    rows = []
    for session, (b, phi) in enumerate(zip(bias, np.radians(turn), strict=True)):
        for i, t in SETTINGS:
            a, c = np.radians(i), np.radians(t)
            force = 1000.0 * np.array([np.cos(a) * np.sin(c), np.cos(a) * np.cos(c), np.sin(a)])
            reading = force + np.cross(phi, force) + b + noise * rng.standard_normal(3)
            rows.append((f"day {session}", i, t, *np.round(reading, 4)))
    return rows


def write(path: Path, rows: list[tuple], header: tuple[str, ...] = HEADER) -> Path:
    with path.open("w", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(header)
        writer.writerows(rows)
    return path


def run(*paths: Path, request: LabRequest = REQUEST) -> LabRun:
    files = LabFiles(paths[0], others=paths[1:])
    return calibrate_files(files, request, lambda _: None)


@pytest.fixture(scope="module")
def planted() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return 8.0 + 0.8 * rng.standard_normal((5, 3)), 0.1 * rng.standard_normal((5, 3))


@pytest.fixture(scope="module")
def told(planted, tmp_path_factory) -> LabRun:
    folder = tmp_path_factory.mktemp("sessions")
    return run(write(folder / "five.csv", rows_of(*planted)))


@pytest.mark.slow
def test_the_scatter_is_that_of_the_analysis_of_variance(told: LabRun, planted) -> None:
    """Balanced data: REML's size of the bias is the sample sd of the sessions' own means, with the
    noise of a mean, 0.2 mg / 4, far below it."""
    for one, truth in zip(told.details.between_sessions.scatter, planted, strict=True):
        assert one.sd == pytest.approx(np.sqrt(truth.var(axis=0, ddof=1).mean()), rel=0.06)


@pytest.mark.slow
def test_a_session_that_was_left_out_errs_by_the_scatter(told: LabRun) -> None:
    held = {split.name: split.final.rms() for split in told.result.splits}
    assert held["another session"] > 1.05 * held["held out"]


@pytest.mark.slow
def test_files_are_sessions_as_a_column_is(told: LabRun, planted, tmp_path: Path) -> None:
    rows = rows_of(*planted)
    each = [
        write(tmp_path / f"day {k}.csv", [r[1:] for r in rows if r[0] == f"day {k}"], HEADER[1:])
        for k in range(5)
    ]
    several = run(*each)
    assert several.details.between_sessions.sessions == told.details.between_sessions.sessions
    assert np.allclose(several.result.final.theta, told.result.final.theta, atol=1e-9)
    assert several.table.row.tolist() == list(range(1, 81))
    assert any("day 1.csv 17-32" in note for note in several.outcome.notes)
    assert several.outcome.provenance.inputs_sha256 == tuple(sha256_of(path) for path in each)


def test_rests_have_sessions_too(planted, tmp_path: Path) -> None:
    rows = rows_of(planted[0], np.zeros((5, 3)))
    path = write(tmp_path / "a.csv", [(r[0], *r[3:]) for r in rows], (HEADER[0], *HEADER[3:]))
    found = run(path, request=replace(REQUEST, reference="norm")).details.between_sessions
    assert [one.effect for one in found.scatter] == ["bias"]
    truth = np.sqrt(planted[0].var(axis=0, ddof=1).mean())
    assert found.scatter[0].sd == pytest.approx(truth, rel=0.25)


def test_recordings_at_rest_are_sessions_read_as_recordings(tmp_path: Path) -> None:
    rng, paths = np.random.default_rng(0), [tmp_path / f"{k}.csv" for k in range(2)]
    for path in paths:
        table = simulate_table(BenchPlan("rings", 12), rng)
        write_recording(simulate_recording(table, rng, rate=50.0, rest=2.0), path)
    found = run(*paths, request=replace(REQUEST, reference="norm"))
    assert found.recorded
    assert found.raw.sentence == "m/s², as the recording was read"
    assert found.details.between_sessions is not None
    assert found.details.between_sessions.sessions == ("0", "1")


def test_what_is_mistaken_is_told(planted, tmp_path: Path) -> None:
    rows = rows_of(*planted)
    whole = write(tmp_path / "a.csv", rows)
    with pytest.raises(UsageError, match="column session beside several files"):
        run(whole, whole)
    bare = write(tmp_path / "b.csv", [r[1:] for r in rows], HEADER[1:])
    other = write(
        tmp_path / "c.csv", [r[1:] for r in rows], (*HEADER[1:3], "x (g)", "y (g)", "z (g)")
    )
    with pytest.raises(UsageError, match="the same readings as"):
        run(bare, bare)
    with pytest.raises(UsageError, match="its units"):
        run(bare, other)
    empty = write(tmp_path / "d.csv", [("", *rows[0][1:]), *rows[1:]])
    with pytest.raises(UnreadableInput, match="session is empty"):
        run(empty)
    each = write(tmp_path / "e.csv", [(k, *row[1:]) for k, row in enumerate(rows)])
    with pytest.raises(UnreadableInput, match="80 sessions of 80 rows"):
        run(each)
    with pytest.raises(UsageError, match="--recording goes with one table"):
        calibrate_files(LabFiles(bare, tmp_path / "x.mcap", others=(bare,)), REQUEST, print)


SCATTER, NOISE = 0.05, 0.5  # deg, mg


def _force(inclination: Array, tool_face: Array) -> Array:
    i, t = np.radians(inclination), np.radians(tool_face)
    return np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def _sensor(rng: np.random.Generator) -> Array:
    lower = np.tril(0.004 * rng.standard_normal((3, 3)), -1)
    return np.eye(3) + np.diag(0.006 * rng.standard_normal(3)) + lower


def _sheets(seed: int, what: str) -> list[str]:
    """Three power-ups of 32 positions, whose third has something of its own."""
    rng = np.random.default_rng(seed)
    inclination = np.repeat([-75.0, -45.0, -20.0, 0.0, 15.0, 30.0, 50.0, 80.0], 4)
    tool_face = np.tile([0.0, 90.0, 180.0, 270.0], 8) + np.repeat(np.arange(8) * 11.0, 4)
    bias, gain, other = 12.0 * rng.standard_normal(3), _sensor(rng), _sensor(rng)
    found = []
    for session in range(3):
        last = session == 2
        i = inclination + SCATTER * np.repeat(rng.standard_normal(8), 4)
        t = tool_face + SCATTER * rng.standard_normal(32)
        i = i + 0.5 * (last and what == "inclination")
        of = other if last and what == "sensor" else gain
        of = of @ np.diag([1.003, 0.998, 1.002]) if last and what == "scale" else of
        reading = 1000.0 * _force(i, t) @ of.T + bias + rng.standard_normal(3)
        loud = 8.0 if last and what == "noise" else 1.0
        reading = reading + loud * NOISE * rng.standard_normal((32, 3))
        rows = np.column_stack([inclination, tool_face, reading])
        lines = [",".join(f"{v:.5f}" for v in row) for row in rows]
        found.append("\n".join(("inclination,tool_face,x_mg,y_mg,z_mg", *lines)) + "\n")
    return found


def _run(folder: Path, sheets: list[str], *declare: str) -> LabRun:
    paths = [folder / f"day_{k}.csv" for k in range(len(sheets))]
    for path, text in zip(paths, sheets, strict=True):
        path.write_text(text)
    files = LabFiles(paths[0], others=tuple(paths[1:]))
    return calibrate_files(files, LabRequest(declare=declare), lambda text: None)


@pytest.mark.slow
@pytest.mark.parametrize("what", ["scale", "inclination"])
def test_what_one_session_has_of_its_own_is_named(what: str, tmp_path: Path) -> None:
    """The scale was a certain drift; the dial nothing, hidden in scatter six times too wide."""
    run = _run(tmp_path, _sheets(1, what))
    assert run.result.loop is not None
    assert [s.effect for s in run.result.loop.steps] == [f"session@3:{what}"]
    error = run.result.error
    assert error.held_out.final < error.held_out.base
    assert np.isnan(error.floor)  # what two sessions differ by is no noise


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_of_sessions_alike_none_is_named(seed: int, tmp_path: Path) -> None:
    run = _run(tmp_path, _sheets(seed, ""))
    assert run.result.loop is not None
    assert not run.result.loop.steps
