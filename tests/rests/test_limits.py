"""What is a rest and what is none: worlds just within each printed limit and just beyond."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from imucalib.recording.recording import Recording
from imucalib.rests import windows
from imucalib.rests.runs import two_ranges
from imucalib.rests.segments import Segments, find_segments, still_segments
from imucalib.rests.stillness import StillSettings
from worlds.recordings import recording_of

Array = np.ndarray
RATE, G = 100.0, 9.80665
MG = 1e-3 * G


def shake(rng: np.random.Generator, seconds: float = 3.0) -> Array:
    n = round(seconds * RATE)
    bell = np.sin(np.pi * (np.arange(n) + 0.5) / n)[:, None]
    return rng.normal(0, 4.0, (n, 3)) * bell + [0, 0, G]


def recorded(values: Array, rate: Array | None = None) -> Recording:
    return recording_of(np.arange(len(values)) / RATE, values, rate, hz=RATE)


def bench(
    rng: np.random.Generator, lengths: list[float], noise: float = 2 * MG, pause: float = 3.0
) -> tuple[Array, list[tuple[float, float]]]:
    """Rests (s) in random attitudes between shakes of `pause` s; readings and planted spans."""
    parts, spans, at = [], [], 0
    for length in [*lengths, 0.0]:
        parts.append(shake(rng, pause))
        n, direction = len(parts[-1]), rng.normal(size=3)
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


def middle_of(rng: np.random.Generator, change: Array, noise: float) -> Array:
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


def in_blocks(values: Array) -> list[Recording]:
    t, parts = np.arange(len(values)) / RATE, pairwise(range(0, len(values) + 1, 450))
    return [recording_of(t[a:b], values[a:b], hz=RATE) for a, b in parts]


@pytest.mark.parametrize("most", [0, 1 << 24])
def test_a_long_recording_in_blocks_keeps_its_rests(
    most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    values, spans = bench(np.random.default_rng(13), [6.0] * 10)
    monkeypatch.setattr(windows.KeptSamples.__init__, "__defaults__", (most,))
    found = find_segments(in_blocks(values))
    assert found.n == len(spans)
    for k, (a, b) in enumerate(spans):
        assert a - 0.06 <= found.start[k] < a + (0.3 if most else 1.1)
        assert b + 0.06 >= found.stop[k] > b - (0.3 if most else 1.1)
    assert any("too long" in note for note in found.notes) == (not most)


def among_rests(middle: Array, noise: float, rests: int = 4) -> tuple[Array, float, float]:
    """Readings of something between shakes, with rests of five seconds before and after it, in
    white noise (m/s²); its start and stop in s."""
    rng = np.random.default_rng(1)
    plain = np.tile([0.0, 0.0, G], (500, 1))
    before = [part for _ in range(rests) for part in (plain, shake(rng))]
    after = [part for _ in range(rests) for part in (shake(rng), plain)]
    values = np.concatenate([*before, middle, *after])
    at = sum(map(len, before))
    values = values + rng.normal(0, noise, values.shape)
    return values, at / RATE, (at + len(middle)) / RATE


def verdicts(found: Segments, start: float, stop: float) -> set[str]:
    """Reasons, "" for a rest, of what lies in an interval (s) for a second at least."""
    inside = (c for c in found.candidates if c.start < stop and c.stop > start)
    return {c.reason for c in inside if min(c.stop, stop) - max(c.start, start) > 1.0}


def creeping(mg: float, seconds: float) -> Array:
    """A level sensor whose x moves steadily by so many mg in all."""
    n = round(seconds * RATE)
    ramp = mg * MG * (np.arange(n) + 0.5) / n
    return np.stack([ramp, 0 * ramp, np.full(n, G)], axis=1)


@pytest.mark.parametrize(("noise", "rests"), [(27.0, 8), (36.0, 0)])
def test_noise_beyond_thirty_mg_is_shaking(noise: float, rests: int) -> None:
    values, *_ = among_rests(np.tile([0.0, 0.0, G], (500, 1)), noise * MG)
    found = still_segments(recorded(values))
    assert (found.n == 9) == bool(rests)
    assert any("shakes by" in note for note in found.notes) == (not rests)


@pytest.mark.parametrize(("steps", "shaking"), [(1.8, False), (2.4, True)])
def test_noise_beyond_thirty_mg_is_noise_below_two_steps_of_the_resolution(
    steps: float, shaking: bool
) -> None:
    step = 30 * MG
    values, *_ = among_rests(np.tile([0.0, 0.0, G], (500, 1)), steps * step)
    found = still_segments(recorded(np.round(values / step) * step))
    assert any("shakes by" in note for note in found.notes) == shaking


def level(seconds: float, noise: float, seed: int) -> Array:
    """At rest, with so much noise (mg) beside that of the recording."""
    n = round(seconds * RATE)
    return np.random.default_rng(seed).normal([0, 0, G], noise * MG, (n, 3))


def louder(seconds: float, times: float) -> Array:
    """A rest in more noise than the others' 1 mg."""
    return level(seconds, np.sqrt(times**2 - 1), 2)


def dropping(height: float) -> Array:
    """One sample a window of fifty is so many g off."""
    middle = level(8.0, 0.0, 0)
    middle[25::50, 2] -= height * G
    return middle


@pytest.mark.parametrize(
    ("middle", "noise", "rests", "reason"),
    [
        # How far and how fast a mean may go, of what is left where the ends, up to 1.5 s, do not
        # agree with the middle: 0.3 deg of gravity are 5.1 mg,
        (creeping(4.6, 60.0), 0.6, 4, ""),
        (creeping(6.6, 60.0), 0.6, 4, "turning"),
        # and 0.1 mg a minute of warming: 7.1 mg in twenty minutes;
        (creeping(6.2, 1200.0), 0.6, 4, ""),
        (creeping(8.0, 1200.0), 0.6, 4, "turning"),
        # 0.025 deg/s are 0.44 mg/s;
        (creeping(3.6, 10.0), 0.6, 4, ""),
        (creeping(5.0, 10.0), 0.6, 4, "turning"),
        # faster, but less than 2.5 mg in all.
        (creeping(2.2, 4.0), 0.6, 4, ""),
        (creeping(3.2, 4.0), 0.6, 4, "turning"),
        # A louder noise, up to five times, counts where ten windows of half a second share it.
        (louder(8.0, 4.4), 1.0, 8, ""),
        (louder(5.0, 2.4), 1.0, 8, ""),
        (louder(4.5, 2.4), 1.0, 8, "other noise"),
        (louder(8.0, 6.0), 1.0, 8, "vibrating"),
        # What varies by more than three tenths of gravity is a motion.
        (level(8.0, 200.0, 5), 1.0, 4, "vibrating"),
        (level(8.0, 400.0, 5), 1.0, 4, None),
        # A dropout is a tenth of gravity away; what is nearer is a vibration like any other.
        (dropping(0.06), 1.0, 4, "vibrating"),
        (dropping(0.15), 1.0, 4, "dropouts"),
        # A refused stretch has four windows, in whole ones on their grid.
        (level(1.5, 40.0, 6), 1.0, 4, None),
        (level(2.0, 40.0, 6), 1.0, 4, "vibrating"),
    ],
)
def test_what_is_a_rest_and_why_not(
    middle: Array, noise: float, rests: int, reason: str | None
) -> None:
    values, start, stop = among_rests(middle, noise * MG, rests)
    found = verdicts(still_segments(recorded(values)), start, stop)
    assert found == (set() if reason is None else {reason})


@pytest.mark.parametrize(("sway", "whole"), [(2.3, True), (4.0, False)])
def test_a_gyroscope_in_the_hand_may_sway_by_twice_1_4_deg_a_second(
    sway: float, whole: bool
) -> None:
    """Variance at most four times that of 1.4 deg/s; the gyroscope's own noise is far below."""
    values, start, stop = among_rests(np.tile([0.0, 0.0, G], (400, 1)), MG)
    rng = np.random.default_rng(3)
    rate = np.radians(rng.normal(0, 0.05, values.shape))
    inside = slice(round(start * RATE), round(stop * RATE))
    rate[inside, 1] += np.radians(rng.normal(0, sway, 400))
    found = still_segments(recorded(values, rate))
    inner = (found.start < stop) & (found.stop > start)
    assert (float((found.stop - found.start)[inner].sum()) > 3.8) == whole


@pytest.mark.parametrize(("around", "deg_s", "rests"), [(4, 0.06, 9), (2, 0.15, 4), (1, 0.15, 3)])
def test_a_rate_beside_the_bias_is_a_turn_where_five_rests_tell_it(
    around: int, deg_s: float, rests: int
) -> None:
    values, start, stop = among_rests(np.tile([0.0, 0.0, G], (500, 1)), MG, around)
    rng = np.random.default_rng(4)
    rate = np.radians(rng.normal(0.4, 0.02, values.shape))
    rate[round(start * RATE) : round(stop * RATE), 2] += np.radians(deg_s)
    assert still_segments(recorded(values, rate)).n == rests


@pytest.mark.parametrize(("mg", "stretches"), [(0.6, 1), (1.6, 2)])
def test_a_jump_of_more_than_a_milligravity_parts_two_rests(mg: float, stretches: int) -> None:
    """A sensor of a few µg: a knock between two half minutes of rest."""
    middle = np.tile([0.0, 0.0, G], (1000, 1))
    middle[500:, 0] += mg * MG
    values, start, stop = among_rests(middle, 5e-3 * MG)
    found = still_segments(recorded(values))
    inside = [c for c in found.candidates if c.start < stop and c.stop > start and not c.reason]
    assert len(inside) == stretches


@pytest.mark.parametrize(("seconds", "frozen"), [(40.0, False), (90.0, True)])
def test_a_coarse_sensor_that_repeats_itself_for_a_minute_is_dead(
    seconds: float, frozen: bool
) -> None:
    """Its noise is far below its resolution: some rests are constant, and sleep lasts longer."""
    rng = np.random.default_rng(7)
    step = 16 * MG
    parts = []
    for k in range(12):
        n = round((seconds if k == 6 else 5.0) * RATE)
        attitude = rng.normal(size=3)
        rest = G * attitude / np.linalg.norm(attitude) + rng.normal(0, 2 * MG, (n, 3))
        parts += [shake(rng), np.tile([0.0, 0.0, 62 * step], (n, 1)) if k == 6 else rest]
    values = np.round(np.concatenate([*parts, shake(rng)]) / step) * step
    found = still_segments(recorded(values))
    assert any("frozen" in note for note in found.notes) == frozen
    assert found.n == (11 if frozen else 12)


@pytest.mark.parametrize(("shortest", "samples"), [(1.0, 50), (0.5, 25), (3.0, 50), (0.06, 5)])
def test_a_window_is_half_a_second_or_half_the_shortest_rest(shortest: float, samples: int) -> None:
    assert StillSettings(shortest=shortest).samples(RATE) == samples


@pytest.mark.parametrize(
    ("before", "after", "ratio", "two"),
    [
        (5, 5, 2.0, True), (20, 20, 1.35, True), (20, 7, 0.5, True),
        (4, 5, 2.0, False), (3, 3, 4.0, False), (20, 20, 1.25, False),
    ],
)  # fmt: skip
def test_two_ranges_have_five_windows_each_and_a_factor_of_1_3(
    before: int, after: int, ratio: float, two: bool
) -> None:
    size = np.concatenate([np.full(before, G), np.full(after, ratio * G)])
    size *= 1 + 1e-3 * np.random.default_rng(8).normal(size=size.size)
    found = two_ranges(size)
    assert (found is not None) == two
    if found is not None:
        row, first, second = found
        assert row == before
        assert second / first == pytest.approx(ratio, rel=5e-3)
    assert two_ranges(np.geomspace(1.0, 2.0, 40)) is None  # a steady drift
