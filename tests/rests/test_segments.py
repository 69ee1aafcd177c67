"""Rests of whole recordings: planted, stuck, measured, and counts that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.readers import read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Gap, Recording
from imucalib.rests.runs import PostureRuns, posture_runs, scan
from imucalib.rests.segments import still_segments
from imucalib.units import MG, STANDARD_GRAVITY
from worlds.command import run
from worlds.places import MEASURED
from worlds.recordings import recording_of

RATE, SIGMA = 100.0, 0.02


def recorded(t: Array, values: Array, rate: float = RATE, gaps: tuple[Gap, ...] = ()) -> Recording:
    return recording_of(t, values, hz=rate, gaps=gaps)


def tumble(seed: int, rests: int, sigma: float = SIGMA) -> tuple[Recording, list[tuple[int, int]]]:
    """Rests of 3 to 6 s between turns of 1.5 s; sample ranges of the rests."""
    rng = np.random.default_rng(seed)
    parts, spans, at = [], [], 0
    for _ in range(rests):
        n = int(rng.integers(300, 600))
        direction = rng.normal(size=3)
        direction *= 9.81 / np.linalg.norm(direction)
        parts.append(np.tile(direction, (n, 1)))
        spans.append((at, at + n))
        shake = rng.normal(scale=2.0, size=(150, 3))
        parts.append(direction + shake)
        at += n + 150
    values = np.concatenate(parts)
    values = values + rng.normal(scale=sigma, size=values.shape)
    return recorded(np.arange(len(values)) / RATE, values), spans


@pytest.mark.parametrize("seed", range(5))
def test_planted_rests_are_found_with_their_means(seed: int) -> None:
    recording, spans = tumble(seed, 12)
    found = still_segments(recording)
    assert found.n == len(spans)
    values = recording.channels["imu0/acceleration"].values
    for k, (a, b) in enumerate(spans):
        ((first, last),) = found.spans[k][0]
        assert a <= first < last <= b
        np.testing.assert_allclose(found.mean[k, 0], values[first:last].mean(axis=0), atol=1e-12)
        assert found.start[k] == first / RATE
        assert found.stop[k] == (last - 1) / RATE
    # The standard deviation of a standard deviation from some 4000 samples is about 1 %.
    np.testing.assert_allclose(found.noise[0], SIGMA, rtol=0.06)


def test_a_rest_never_crosses_a_gap() -> None:
    recording, spans = tumble(3, 4)
    channel = recording.channels["imu0/acceleration"]
    middle = sum(spans[1]) // 2
    keep = np.r_[0:middle, middle + 30 : channel.t.size]
    gap = Gap(channel.t[middle - 1], channel.t[middle + 30], "no samples")
    found = still_segments(recorded(channel.t[keep], channel.values[keep], gaps=(gap,)))
    assert found.n > 4 or not np.any((found.start < gap.start) & (found.stop > gap.stop))
    assert not np.any((found.start < gap.stop) & (found.stop > gap.start))


def test_frozen_and_clipped_samples_are_left_out() -> None:
    recording, spans = tumble(5, 6)
    old = recording.channels["imu0/acceleration"]
    values = old.values.copy()
    values[spans[1][0] : spans[1][1]] = values[spans[1][0]]  # the sensor repeats itself
    values[spans[3][0] : spans[3][1], 0] = 1.5 * np.abs(values).max()  # one axis at its limit
    found = still_segments(recorded(old.t, values))
    assert found.n == 4
    assert any("frozen" in n for n in found.notes)
    assert any("clipped" in n for n in found.notes)


@pytest.mark.parametrize("name", ["imu0.log.gz", "imu1.log.gz"])
def test_rests_of_the_tumble_logs(name: str) -> None:
    mapping = FieldMapping(
        acc=("1", "2", "3"), gyro=("4", "5", "6"), acc_unit="m/s2", gyro_unit="rad/s", rate=100
    )
    found = still_segments(read(MEASURED / name, mapping))
    assert 21 <= found.n <= 24


G, STUCK_RATE, REST = STANDARD_GRAVITY, 10.0, 400  # samples


def worn(rests: int, noise: float, step: float) -> Array:
    """(n, 3) m/s²: rests of 40 s in postures of their own, each with a movement of 10 s before;
    noise of a sample and step of the reading in mg."""
    rng = np.random.default_rng(4)
    x = rng.standard_normal((rests, 3))
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    g = np.repeat(x, REST + 100, axis=0)
    g += 1e-3 * noise * rng.standard_normal(g.shape)
    moves = np.arange(len(g)) % (REST + 100) < 100
    g[moves] += 0.2 * rng.standard_normal((int(moves.sum()), 3))
    return np.asarray(MG * step * np.round(1e3 * g / step))


def found(values: Array) -> PostureRuns:
    t = np.arange(len(values)) / STUCK_RATE
    return posture_runs(scan([recorded(t, values, STUCK_RATE)], 10.0))


@pytest.mark.parametrize("held", [-0.3, 0.0, -0.0])
@pytest.mark.parametrize("noise", [3.0, 0.1], ids=["fine", "coarse"])
def test_an_axis_that_stands_still_while_others_move_is_left_out(noise: float, held: float) -> None:
    values = worn(40, noise, 1.0)
    values[5000:10000, 1] = held * G
    runs = found(values)
    assert not np.any((runs.time > 500.0) & (runs.time < 1000.0))
    assert runs.time.size >= 28
    assert runs.faults == (
        f"y repeats {held + 0.0:.3g} g for 8.3 min from 0.14 h on, while it should move: stuck, or "
        "at a limit; left out of the rests",
    )


def test_an_axis_that_is_held_and_keeps_its_noise_is_left_out() -> None:
    """It stood in the fit, which it took from 0.4 to 33 mg; the others are not blamed for it."""
    values = worn(40, 3.0, 1.0)
    noise = MG * np.round(3.0 * np.random.default_rng(5).standard_normal(5000))
    values[5000:10000, 1] = -0.3 * G + noise
    runs = found(values)
    assert not np.any((runs.time > 500.0) & (runs.time < 1000.0))
    assert runs.time.size >= 28
    assert runs.faults == (
        "y stays at -0.3 g for 8.3 min from 0.14 h on, whatever the others do: it is not its own "
        "reading; left out of the rests",
    )


def test_of_what_is_shaken_all_the_time_no_axis_is_said_to_stay() -> None:
    """Noise of 170 mg changes gravity's size by itself."""
    values = np.array([0.0, G, 0.0]) + np.random.default_rng(5).normal(0.0, 0.17 * G, (20000, 3))
    seconds = np.arange(20000.0)
    with pytest.raises(Undetermined, match=r"^(?!.*stays at).*shakes by 1[67]\d mg"):
        posture_runs(scan([recorded(seconds, values, 1.0)], 10.0))


@pytest.mark.parametrize("noise", [3.0, 0.6, 0.1])
def test_a_live_axis_is_not_stuck(noise: float) -> None:
    runs = found(worn(40, noise, 1.0))
    assert runs.faults == ()
    assert runs.n == 40


@pytest.mark.parametrize("step", [4.0, 16.0])
def test_rests_that_repeat_one_step_are_rests(step: float) -> None:
    """They were frozen, and the quietest motion the noise, which shook: nothing was still."""
    runs = found(worn(60, 0.0, step))
    assert runs.n == 60
    assert runs.faults == runs.notes == ()
    assert np.all(runs.noise < 0.5 * runs.resolution)


def test_a_limit_below_gravity_is_told_with_its_axis() -> None:
    values = worn(60, 3.0, 1.0)
    up = np.minimum(values[:, 0], 0.9 * G)
    values[:, 0] = up
    runs = found(values)
    assert [text.partition(":")[0] for text in runs.faults] == ["x reads nothing above 0.9 g"]
    assert np.all(runs.mean[:, 0] < 0.9 * G)


def test_an_axis_that_never_moves_is_refused() -> None:
    values = worn(20, 3.0, 1.0)
    values[:, 0] = 0.0
    with pytest.raises(Undetermined, match=r"x repeats 0 g for 17 min from 0\.00 h on"):
        found(values)


HEAD = """\
------------ Data File Created By ActiGraph GT3X+ ActiLife v6.11.5 Firmware v2.5.0 date format \
M/d/yyyy at 30 Hz  Filter Normal -----------
Serial Number: CLE2B21130054
Start Time 11:00:00
Start Date 9/17/2014
Epoch Period (hh:mm:ss) 00:00:{}
Current Memory Address: 0
--------------------------------------------------
"""


@pytest.mark.parametrize("columns", ["", "Axis1,Axis2,Axis3\n"])
@pytest.mark.parametrize("command", ["actigraph", "inspect"])
def test_an_epoch_file_is_named_as_what_it_is(tmp_path: Path, columns: str, command: str) -> None:
    path, rows = tmp_path / "epochs.csv", np.random.default_rng(0).poisson(60, (3000, 3))
    text = "\n".join(",".join(map(str, row)) for row in rows)
    path.write_text(HEAD.format("05") + columns + text + "\n", encoding="utf-8")
    result = run(command, path)
    assert isinstance(result.exception, UnreadableInput)
    assert "activity counts per epoch of 00:00:05, not acceleration" in str(result.exception)
    assert ".gt3x" in str(result.exception)
