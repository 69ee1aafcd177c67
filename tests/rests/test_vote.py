"""A board's rests: each sensor more makes them surer, and one sensor's loud samples end none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments, still_segments
from imucalib.units import DEG, STANDARD_GRAVITY

RATE, RESTS, REST, TURN = 100.0, 8, 220, 120
SIGMA, SIGMA_GYRO = 3e-3 * STANDARD_GRAVITY, 0.15 * DEG


def turned(rng: np.random.Generator) -> tuple[Array, Array, list[tuple[float, float]]]:
    """Force (N, 3) m/s² and rate (N, 3) rad/s of a board that is turned from rest to rest, and the
    times of the rests, s."""
    attitude, up = Rotation.random(random_state=int(rng.integers(1 << 30))), STANDARD_GRAVITY
    force, rate, rests = [], [], []
    for k in range(RESTS):
        begin = k * (REST + TURN) / RATE
        rests.append((begin, begin + REST / RATE))
        axis = rng.normal(size=3)
        axis *= rng.uniform(1.2, 2.5) / np.linalg.norm(axis)
        share = np.append(np.zeros(REST), 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, TURN)))
        on = attitude * Rotation.from_rotvec(share[:, None] * axis)
        force.append(on.inv().apply([0.0, 0.0, up]))
        rate.append(np.gradient(share, 1.0 / RATE)[:, None] * axis)
        attitude = on[-1]
    return np.concatenate(force), np.concatenate(rate), rests


def board(chips: int, seed: int) -> tuple[Recording, list[tuple[float, float]], Array]:
    """A log of chips that sit anyhow, with Student noise of five degrees of freedom; the times of
    the rests; and the forces (K, N, 3) without noise."""
    rng = np.random.default_rng(seed)
    force, rate, rests = turned(rng)
    t, channels, true = np.arange(len(force)) / RATE, dict[str, Channel](), []
    for k in range(chips):
        sits = Rotation.random(random_state=int(rng.integers(1 << 30)))
        true.append(sits.apply(force) + rng.normal(size=3) * 0.1)
        noise = rng.normal(size=(2, *force.shape)) / np.sqrt(rng.chisquare(5.0, (2, len(t), 3)) / 5)
        a, w = true[-1] + SIGMA * noise[0], sits.apply(rate) + SIGMA_GYRO * noise[1]
        name = f"imu{k}"
        channels[f"{name}/acceleration"] = Channel(t, a, "m/s2", "acceleration", name, RATE)
        channels[f"{name}/angular_rate"] = Channel(t, w, "rad/s", "angular_rate", name, RATE)
    return Recording(channels, "board.csv", "csv", "0" * 64), rests, np.array(true)


def of_which(found: Segments, rests: list[tuple[float, float]]) -> list[int]:
    """Which planted rest each found one lies in, -1 where it reaches into a motion."""
    pairs = zip(found.start, found.stop, strict=True)
    within = [[k for k, (a, b) in enumerate(rests) if a <= p and q < b] for p, q in pairs]
    return [own[0] if own else -1 for own in within]


@pytest.mark.parametrize("chips", [3, 4, 8, 16])
@pytest.mark.parametrize("seed", range(2))
def test_each_chip_more_loses_no_rest(chips: int, seed: int) -> None:
    recording, rests, true = board(chips, seed)
    found = still_segments(recording)
    assert of_which(found, rests) == list(range(RESTS))
    for k in range(chips):
        errors = found.mean[:, k] - found.means(true[k], k)
        limit = 6.0 * np.sqrt(5.0 / 3.0) * SIGMA / np.sqrt(found.samples[:, k, None])
        assert np.all(np.abs(errors) < limit)


@pytest.mark.parametrize("quantity", ["acceleration", "angular_rate"])
def test_a_loud_sample_of_one_chip_is_in_no_mean_and_ends_no_rest(quantity: str) -> None:
    recording, rests, _ = board(4, 3)
    plain = still_segments(recording)
    name, middle = f"imu2/{quantity}", REST // 2
    channel = recording.channels[name]
    values = channel.values.copy()
    values[middle] += 3.0 * STANDARD_GRAVITY  # or rad/s
    struck = still_segments(
        replace(recording, channels={**recording.channels, name: replace(channel, values=values)})
    )
    assert of_which(struck, rests) == of_which(plain, rests) == list(range(RESTS))
    assert struck.stop[0] - struck.start[0] == plain.stop[0] - plain.start[0]
    error = np.abs(struck.mean[0, 2] - plain.mean[0, 2])
    assert np.all(error < 6.0 * SIGMA / np.sqrt(struck.samples[0, 2]))
    error = np.abs(struck.rate[0, 2] - plain.rate[0, 2])
    assert np.all(error < 6.0 * SIGMA_GYRO / np.sqrt(REST / 4))


def test_a_chip_that_is_dead_in_a_rest_is_not_outvoted() -> None:
    recording, rests, _ = board(4, 4)
    channel = recording.channels["imu1/acceleration"]
    values = channel.values.copy()
    first = REST + TURN
    values[first - TURN // 2 : first + REST + TURN // 2] = values[first]
    name = "imu1/acceleration"
    held = replace(recording.channels[name], values=values)
    found = still_segments(replace(recording, channels={**recording.channels, name: held}))
    assert of_which(found, rests) == [0, *range(2, RESTS)]
