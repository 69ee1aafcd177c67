"""What is a rest and what is none, on worlds that know nothing of the detector's constants."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from imucalib.recording.recording import Channel, Recording
from imucalib.rests import windows
from imucalib.rests.segments import Segments, find_segments, still_segments

RATE, G = 100.0, 9.80665
MG = 1e-3 * G


def recorded(values: np.ndarray, rate: np.ndarray | None = None) -> Recording:
    t = np.arange(len(values)) / RATE
    channels = {"imu0/acceleration": Channel(t, values, "m/s2", "acceleration", "imu0", RATE)}
    if rate is not None:
        channels["imu0/angular_rate"] = Channel(t, rate, "rad/s", "angular_rate", "imu0", RATE)
    return Recording(channels, "made", "made", "")


def bench(
    rng: np.random.Generator, lengths: list[float], noise: float = 2 * MG, pause: float = 3.0
) -> tuple[np.ndarray, list[tuple[float, float]]]:
    """Rests (s) in random attitudes between shakes of `pause` s; readings and planted spans."""
    parts, spans, at = [], [], 0
    for length in [*lengths, 0.0]:
        n = round(pause * RATE)
        bell = np.sin(np.pi * (np.arange(n) + 0.5) / n)[:, None]
        parts.append(rng.normal(0, 4.0, (n, 3)) * bell + [0, 0, G])
        direction = rng.normal(size=3)
        still = round(length * RATE)
        parts.append(np.tile(G * direction / np.linalg.norm(direction), (still, 1)))
        spans.append(((at + n) / RATE, (at + n + still) / RATE))
        at += n + still
    values = np.concatenate(parts)
    return values + rng.normal(0, noise, values.shape), spans[:-1]


def called_rest(found: Segments, a: float, b: float) -> float:
    """Share of an interval."""
    shared = np.minimum(found.stop, b) - np.maximum(found.start, a)
    return float(np.maximum(shared, 0.0).sum() / (b - a))


def reasons(found: Segments, a: float, b: float) -> set[str]:
    return {c.reason for c in found.candidates if c.start < b and c.stop > a}


@pytest.mark.parametrize("length", [1.05, 1.4, 2.0, 2.2, 2.4, 2.9])
@pytest.mark.parametrize("pause", [3.0, 27.0])
def test_rests_are_found_down_to_the_shortest(length: float, pause: float) -> None:
    values, spans = bench(np.random.default_rng(7), [length] * 8, pause=pause)
    found = still_segments(recorded(values))
    assert found.n == len(spans)
    for k, (a, b) in enumerate(spans):
        assert abs(found.start[k] - a) < 0.12
        assert abs(found.stop[k] - b) < 0.12


def middle_of(rng: np.random.Generator, change: np.ndarray, noise: float) -> np.ndarray:
    """Five-second rests with something slow among them, which moves across gravity."""
    rests, _ = bench(rng, [5.0] * 4, noise)
    others, _ = bench(rng, [5.0] * 4, noise)
    slow = np.array([0.0, 0.0, G]) + change + rng.normal(0, noise, (len(change), 3))
    return np.concatenate([rests, slow, others])


SLOW = {
    "0.05 deg/s": lambda t: G * np.sin(np.radians(0.05) * t),
    "0.2 deg/s": lambda t: G * np.sin(np.radians(0.2) * t),
    "0.5 deg/s": lambda t: G * np.sin(np.radians(0.5) * t),
    "creep": lambda t: 30 * MG * t / t[-1],
    "settling creep": lambda t: 30 * MG * (1 - np.exp(-t / 10.0)),
    "hand": lambda t: 15 * MG * (np.sin(0.9 * t) + np.sin(0.37 * t)),
}


@pytest.mark.parametrize("name", SLOW)
@pytest.mark.parametrize("noise", [0.2, 1.0, 3.0])
@pytest.mark.parametrize("gyroscope", [False, True])
def test_what_moves_slowly_is_no_rest(name: str, noise: float, gyroscope: bool) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(6000) / RATE
    change = np.stack([SLOW[name](t), 0 * t, 0 * t], axis=1)
    values = middle_of(rng, change, noise * MG)
    start = (len(values) - len(t)) / 2 / RATE
    rate = np.radians(rng.normal(0.4, 0.05, values.shape)) if gyroscope else None
    found = still_segments(recorded(values, rate))
    # Where a hand turns back it stands still for a second, within a milligravity.
    assert called_rest(found, start, start + 60.0) < (0.1 if name == "hand" else 0.02)
    assert called_rest(found, 0.0, start) == pytest.approx(20.0 / 35.0, abs=0.02)
    assert "turning" in reasons(found, start, start + 60.0)


def test_a_turn_about_gravity_is_told_by_the_gyroscope() -> None:
    rng = np.random.default_rng(2)
    values = middle_of(rng, np.zeros((6000, 3)), 2 * MG)
    turned = np.radians(rng.normal(0.4, 0.05, values.shape))
    middle = slice(len(values) // 2 - 3000, len(values) // 2 + 3000)
    turned[middle, 2] += np.radians(0.5)
    assert still_segments(recorded(values)).n == 9
    found = still_segments(recorded(values, turned))
    assert found.n == 8
    assert "turning" in reasons(found, middle.start / RATE, middle.stop / RATE)


def test_a_warm_up_within_a_long_rest_is_no_turn() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(60_000) / RATE
    warm = 3 * MG * (1 - np.exp(-t / 200.0))
    values = middle_of(rng, np.stack([warm, 0 * t, warm], axis=1), 2 * MG)
    found = still_segments(recorded(values))
    assert found.n == 9
    assert np.max(found.stop - found.start) > 595.0


def in_blocks(values: np.ndarray) -> list[Recording]:
    channel = recorded(values).channels["imu0/acceleration"]
    return [
        Recording(
            {"imu0/acceleration": Channel(channel.t[a:b], values[a:b], "m/s2", "acceleration",
                                          "imu0", RATE)},
            "made", "made", "",
        )
        for a, b in pairwise(range(0, len(values) + 1, 450))
    ]  # fmt: skip


@pytest.mark.parametrize("most", [0, 1 << 24])
def test_a_long_recording_in_blocks_keeps_its_rests(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    values, spans = bench(np.random.default_rng(13), [6.0] * 10)
    monkeypatch.setattr(windows.Samples.__init__, "__defaults__", (most,))
    found = find_segments(in_blocks(values))
    assert found.n == len(spans)
    for k, (a, b) in enumerate(spans):
        assert a - 0.06 <= found.start[k] < a + (0.3 if most else 1.1)
        assert b + 0.06 >= found.stop[k] > b - (0.3 if most else 1.1)
    assert any("too long" in note for note in found.notes) == (not most)
