"""A clock that is set back: nothing is lost, nothing is put out of order, and it is told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.readers import blocks, read
from imucalib.readers.joining import join
from imucalib.recording.recording import Channel, Recording

RATE = 10.0


def autumn(
    folder: Path, *, lose: range = range(0), back: float = 3600.0
) -> tuple[Path, np.ndarray]:
    """An hour and a half of local time, the clock set back by `back` s after an hour."""
    n = round(5400 * RATE)
    t = 1_603_587_600.0 + np.arange(n) / RATE
    t[round(3600 * RATE) :] -= back
    rng = np.random.default_rng(1)
    values = np.array([0.0, 0.0, 1.0]) + rng.normal(scale=0.003, size=(n, 3)).round(5)
    rows = [k for k in range(n) if k not in lose]
    path = folder / "a.csv"
    path.write_text(
        "unix [s],x,y,z [g]\n".replace("x,y,z [g]", "x [g],y [g],z [g]")
        + "".join(
            f"{t[k]:.1f},{values[k, 0]:.5f},{values[k, 1]:.5f},{values[k, 2]:.5f}\n" for k in rows
        )
    )
    return path, values[rows] * 9.80665


def test_the_end_of_summer_time_makes_two_parts(tmp_path: Path) -> None:
    path, values = autumn(tmp_path)
    found = read(path)
    acc = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(acc.values, values, atol=1e-9)
    np.testing.assert_allclose(acc.t, np.arange(acc.t.size) / RATE, atol=1e-6)
    (gap,) = found.gaps
    assert (gap.start, gap.stop) == (pytest.approx(3599.9), pytest.approx(3600.0))
    assert "set back by 3599.9 s" in gap.reason
    assert sum("a part of its own" in note for note in found.notes) == 1


@pytest.mark.slow
@pytest.mark.parametrize("size", [1000, 36_000, 10**6])
def test_blocks_do_not_matter(size: int, tmp_path: Path) -> None:
    path, _ = autumn(tmp_path, lose=range(45_000, 45_100))
    whole, parts = read(path), join(blocks(path, block_samples=size), "")
    np.testing.assert_allclose(
        parts.channels["imu0/acceleration"].t, whole.channels["imu0/acceleration"].t, atol=1e-6
    )
    assert len(whole.gaps) == len(parts.gaps) == 2
    assert whole.gaps[1].start == pytest.approx(4499.9)  # a gap of the second part moves with it
    for one, two in zip(whole.gaps, parts.gaps, strict=True):
        assert (one.start, one.stop) == (pytest.approx(two.start), pytest.approx(two.stop))


@pytest.mark.parametrize("suffix", [".h5", ".csv"])
def test_every_format_keeps_the_order(suffix: str, tmp_path: Path) -> None:
    n = 4000
    t = np.arange(n) / 100.0
    t[2000:] -= 15.0
    rng = np.random.default_rng(2)
    values = np.array([0.0, 0.0, 9.8]) + rng.normal(scale=0.02, size=(n, 3))
    acc = Channel(t, values, "m/s2", "acceleration", "imu0", 100.0)
    path = tmp_path / f"a{suffix}"
    made = Recording({"imu0/acceleration": acc}, "made", "made", "", start_ns=1_600_000_000 * 10**9)
    writers.write(made, path)
    found = readers.read(path)
    back = found.channels["imu0/acceleration"]
    np.testing.assert_array_equal(back.values, values)
    np.testing.assert_allclose(back.t, np.arange(n) / 100.0, atol=1e-6)
    assert any("set back by 14.99 s" in note for note in found.notes)


@pytest.mark.parametrize("row", [0, 1, 2, 3, 500, 1998, 1999])
@pytest.mark.parametrize("off", [-90.0, 90.0, 9e6])
def test_one_wrong_stamp_sets_no_clock(row: int, off: float, tmp_path: Path) -> None:
    t = np.arange(2000) / 100.0 + 100.0
    wrong = t.copy()
    wrong[row] += off
    values = np.tile([[0.0, 0.0, 1.0]], (2000, 1)) + np.arange(6000).reshape(-1, 3) % 7 / 1000
    path = tmp_path / "a.csv"
    rows = zip(wrong, *values.T, strict=True)
    path.write_text(
        "t [s],x [g],y [g],z [g]\n"
        + "".join(f"{s:.2f},{x:.3f},{y:.3f},{z:.3f}\n" for s, x, y, z in rows)
    )
    for found in (read(path), join(blocks(path, block_samples=200), "")):
        acc = found.channels["imu0/acceleration"]
        same = np.delete(np.arange(acc.t.size), row)
        np.testing.assert_allclose(acc.t[same], t[same], atol=1e-9)
        assert not any("part of its own" in note for note in found.notes)
