"""Idle sleep: what an export repeats is no measurement, and the rest before it counts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.readers.csv.reader import without_repeats
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.rests.runs import WORN, posture_runs, scan
from imucalib.units import STANDARD_GRAVITY

RATE = 20.0


def recording(values: np.ndarray) -> Recording:
    t = np.arange(len(values)) / RATE
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", RATE)
    return Recording({"imu0/acceleration": channel}, "made", "csv", "")


def asleep(seconds: list[tuple[int, bool]]) -> np.ndarray:
    """Seconds of fresh readings, or (True) of the last one repeated."""
    rng = np.random.default_rng(0)
    rows = [np.zeros((1, 3))]
    for length, sleeping in seconds:
        n = length * int(RATE)
        fresh = rng.standard_normal((n, 3))
        rows.append(np.repeat(rows[-1][-1:], n, axis=0) if sleeping else fresh)
    return np.concatenate(rows)[1:]


def in_blocks(whole: Recording, rows: int) -> list[Recording]:
    channel = whole.channels["imu0/acceleration"]
    parts = []
    for a in range(0, channel.t.size, rows):
        cut = replace(channel, t=channel.t[a : a + rows], values=channel.values[a : a + rows])
        parts.append(replace(whole, channels={"imu0/acceleration": cut}))
    return parts


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.integers(1, 4), st.booleans()), min_size=1, max_size=6),
    st.integers(1, 130),
)
def test_blocks_do_not_matter(seconds: list[tuple[int, bool]], rows: int) -> None:
    whole = recording(asleep([(1, False), *seconds]))
    (one,) = without_repeats(iter([whole]))
    parts = list(without_repeats(iter(in_blocks(whole, rows))))
    many = [p.channels["imu0/acceleration"] for p in parts]
    assert np.array_equal(one.channels["imu0/acceleration"].t, np.concatenate([c.t for c in many]))
    assert one.gaps == tuple(g for p in parts for g in p.gaps)
    assert one.notes == tuple(n for p in parts for n in p.notes)


@pytest.mark.parametrize("rows", [37, 10**6])
def test_the_rest_before_a_gap_is_a_window(rows: int) -> None:
    rng = np.random.default_rng(1)
    rest = STANDARD_GRAVITY * np.array([0.6, 0.0, 0.8])
    values = rest + 0.04 * rng.standard_normal((int(RATE) * 44, 3))
    row = np.arange(len(values))
    moving = (row < 31 * RATE) | (row >= 40 * RATE)
    values[moving] += 2.0 * rng.standard_normal((int(moving.sum()), 3))
    whole = recording(values)
    channel = whole.channels["imu0/acceleration"]
    keep = (channel.t < 37.0) | (channel.t >= 40.0)
    cut = replace(channel, t=channel.t[keep], values=channel.values[keep])
    gap = Gap(36.95, 40.0, "idle sleep")
    parts = in_blocks(replace(whole, channels={"imu0/acceleration": cut}), rows)
    first = next(k for k, p in enumerate(parts) if p.channels["imu0/acceleration"].t[-1] >= 40.0)
    parts = [replace(p, gaps=(gap,) if k == first else ()) for k, p in enumerate(parts)]
    runs = posture_runs(scan(parts, WORN.window))
    assert runs.n == 1
    assert runs.time[0] == pytest.approx(34.5, abs=0.1)
    assert np.allclose(runs.mean[0], rest, atol=0.02)
