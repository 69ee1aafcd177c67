"""Still segments: planted ones are found, streaming changes nothing, real logs give their rests."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.readers import read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.rests.segments import Segments, find_segments, still_segments
from worlds.places import DATA, MEASURED, needs_data

RATE, SIGMA = 100.0, 0.02


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
    t = np.arange(len(values)) / RATE
    channel = Channel(t, values, "m/s2", "acceleration", "imu0", RATE)
    return Recording({"imu0/acceleration": channel}, "made", "made", ""), spans


def cut(recording: Recording, edges: list[int]) -> list[Recording]:
    (name, c), *_ = recording.channels.items()
    bounds = [0, *edges, c.t.size]
    return [
        Recording(
            {name: Channel(c.t[a:b], c.values[a:b], c.unit, c.quantity, c.triad, c.rate)},
            "made", "made", "",
        )
        for a, b in pairwise(bounds)
        if b > a
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(5))
def test_planted_rests_are_found_with_their_means(seed: int) -> None:
    recording, spans = tumble(seed, 12)
    found = still_segments(recording)
    assert found.n == len(spans)
    values = recording.channels["imu0/acceleration"].values
    for k, (a, b) in enumerate(spans):
        first, last = int(found.first[k, 0]), int(found.last[k, 0])
        assert a <= first < last <= b
        np.testing.assert_allclose(found.mean[k, 0], values[first:last].mean(axis=0), atol=1e-12)
        assert found.start[k] == first / RATE
        assert found.stop[k] == (last - 1) / RATE
    # The standard deviation of a standard deviation from some 4000 samples is about 1 %.
    np.testing.assert_allclose(found.noise[0], SIGMA, rtol=0.06)


@pytest.mark.slow
@given(st.lists(st.integers(1, 6000), max_size=6), st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_blocks_give_what_the_whole_gives(edges: list[int], seed: int) -> None:
    recording, _ = tumble(seed, 8)
    size = recording.channels["imu0/acceleration"].t.size
    whole = still_segments(recording)
    parts = find_segments(cut(recording, sorted({e for e in edges if e < size})))
    for name in Segments.__dataclass_fields__:
        one, two = getattr(whole, name), getattr(parts, name)
        np.testing.assert_array_equal(one, two, err_msg=name)


def test_a_rest_never_crosses_a_gap() -> None:
    recording, spans = tumble(3, 4)
    channel = recording.channels["imu0/acceleration"]
    middle = sum(spans[1]) // 2
    keep = np.r_[0:middle, middle + 30 : channel.t.size]
    moved = Channel(channel.t[keep], channel.values[keep], "m/s2", "acceleration", "imu0", RATE)
    gap = Gap(channel.t[middle - 1], channel.t[middle + 30], "no samples")
    found = still_segments(Recording({"imu0/acceleration": moved}, "", "", "", gaps=(gap,)))
    assert found.n > 4 or not np.any((found.start < gap.start) & (found.stop > gap.stop))
    assert not np.any((found.start < gap.stop) & (found.stop > gap.start))


def test_frozen_and_clipped_samples_are_left_out() -> None:
    recording, spans = tumble(5, 6)
    old = recording.channels["imu0/acceleration"]
    values = old.values.copy()
    values[spans[1][0] : spans[1][1]] = values[spans[1][0]]  # the sensor repeats itself
    values[spans[3][0] : spans[3][1], 0] = 1.5 * np.abs(values).max()  # one axis at its limit
    channel = Channel(old.t, values, "m/s2", "acceleration", "imu0", RATE)
    found = still_segments(Recording({"imu0/acceleration": channel}, "", "", ""))
    assert found.n == 4
    assert any("frozen" in n for n in found.notes)
    assert any("clipped" in n for n in found.notes)


def test_temperature_and_rate_come_along() -> None:
    recording, spans = tumble(8, 5)
    acc = recording.channels["imu0/acceleration"]
    gyro = np.random.default_rng(0).normal([0.01, -0.02, 0.03], 0.002, acc.values.shape)
    slow = np.arange(0.0, acc.t[-1], 1.0)
    channels = {
        "imu0/acceleration": acc,
        "imu0/angular_rate": Channel(acc.t, gyro, "rad/s", "angular_rate", "imu0", RATE),
        "imu0/temperature": Channel(
            slow, 20.0 + 0.1 * slow[:, None], "degC", "temperature", "imu0", 1.0
        ),
    }
    found = still_segments(Recording(channels, "", "", ""))
    assert found.n == len(spans)
    np.testing.assert_allclose(found.rate.mean(axis=(0, 1)), [0.01, -0.02, 0.03], atol=5e-4)
    middle = 0.5 * (found.start + found.stop)
    np.testing.assert_allclose(found.temperature[:, 0], 20.0 + 0.1 * middle, atol=0.01)


def attitudes(found: Segments) -> int:
    """Segments that differ from the one before by more than 5 degrees, plus one."""
    unit = found.mean[:, 0] / np.linalg.norm(found.mean[:, 0], axis=1)[:, None]
    cosine = np.clip(np.sum(unit[1:] * unit[:-1], axis=1), -1, 1)
    return 1 + int(np.sum(np.degrees(np.arccos(cosine)) > 5.0))


@needs_data
def test_rests_of_the_xsens_log() -> None:
    counts = FieldMapping(
        acc=("2", "3", "4"),
        time="1",
        acc_unit="counts",
        lsb_per_g=(415 * 9.80665, 413 * 9.80665, 415 * 9.80665),
        acc_offset=(33123, 33276, 32360),
    )
    found = still_segments(read(DATA / "xsens_mti" / "xsens_acc.txt", counts))
    assert attitudes(found) == 38  # the initial rest and 37 more
    assert found.n == 44  # with those that a touch parts, as a careful cut by hand finds them
    assert np.sum(found.stop - found.start) > 340.0


@pytest.mark.parametrize("name", ["imu0.log.gz", "imu1.log.gz"])
def test_rests_of_the_tumble_logs(name: str) -> None:
    mapping = FieldMapping(
        acc=("1", "2", "3"), gyro=("4", "5", "6"), acc_unit="m/s2", gyro_unit="rad/s", rate=100
    )
    found = still_segments(read(MEASURED / name, mapping))
    assert 21 <= found.n <= 24
