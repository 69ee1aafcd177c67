"""What a recording's inspection tells, and its noise by definition."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from gates.bounds import at_most
from imucalib import readers, writers
from imucalib.arrays import Array
from imucalib.inspection.inspection import inspect_recording, problems
from imucalib.inspection.noise import AllanCurve, AllanSums, Coefficient, identify, noise_at_rest
from imucalib.recording.recording import Gap, Recording
from imucalib.rests.segments import still_segments
from imucalib.units import STANDARD_GRAVITY
from worlds.places import ROOT
from worlds.recordings import recording_of

RATE = 100.0


def recording() -> Recording:
    rng = np.random.default_rng(4)
    parts = []
    for k in range(4):
        rest = np.zeros(3)
        rest[k % 3] = STANDARD_GRAVITY
        parts.append(np.tile(rest, (500, 1)))
        parts.append(rng.normal(scale=4.0, size=(100, 3)))
    values = np.concatenate(parts) + rng.normal(scale=0.01, size=(2400, 3))
    t = np.arange(2400) / RATE
    t[1200:] += 3.0
    t[50] = t[49]
    gyro = rng.normal([0.02, 0.0, 0.0], 0.001, (2400, 3))
    gap = Gap(float(t[1199]), float(t[1200]), "no samples")
    about = {"gaps": (gap,), "notes": ("a note",), "mapping": {"acc": ["x"]}}
    return recording_of(t, values, gyro, hz=RATE, start_ns=5, **about)


def test_facts() -> None:
    found = inspect_recording([recording()])
    acc, gyro = found.channels
    assert (acc.samples, acc.unit) == (2400, "m/s2")
    assert (acc.duplicates, acc.back_steps) == (1, 0)
    assert acc.rate_hz == pytest.approx(RATE)
    assert acc.longest_step_s == pytest.approx(3.01)
    assert acc.jitter_s < 1e-9
    assert acc.norm_at_rest == pytest.approx(STANDARD_GRAVITY, rel=1e-3)
    np.testing.assert_allclose(acc.noise, 0.01, rtol=0.1)
    assert gyro.norm_at_rest == pytest.approx(0.02, rel=0.05)
    assert found.span == pytest.approx(2399 / RATE + 3.0)
    assert found.gap_count == 1
    assert found.gap_seconds == pytest.approx(3.01)
    assert found.still is not None
    assert found.still.n == 4
    assert found.candidates[0][0] == "imu0/acceleration"
    assert found.notes[0] == "a note"
    assert found.mapping == {"acc": ["x"]}


def test_a_clock_that_steps_back_speaks_against_a_calibration() -> None:
    seen = recording()
    t = seen.channels["imu0/acceleration"].t.copy()
    t[2000:] -= 5.0
    channels = {name: replace(one, t=t) for name, one in seen.channels.items()}
    said = tuple(problems(inspect_recording([replace(seen, channels=channels)])))
    assert any("time steps back 1 time" in one for one in said), said


def test_blocks_and_whole_agree(tmp_path: object) -> None:
    path = f"{tmp_path}/a.h5"
    writers.write(recording(), path)
    one = inspect_recording([readers.read(path)])
    many = inspect_recording(readers.blocks(path, block_samples=100))
    for a, b in zip(one.channels, many.channels, strict=True):
        assert (a.name, a.samples, a.norm_at_rest) == (b.name, b.samples, b.norm_at_rest)
        assert (a.duplicates, a.longest_step_s) == (b.duplicates, b.longest_step_s)
        np.testing.assert_array_equal(a.low, b.low)
    assert one.gaps == many.gaps


HZ = 100.0


def curve(values: Array, *, pieces: int = 1, rate: float = HZ) -> AllanCurve:
    sums = AllanSums(1)
    for part in np.array_split(values[:, None], pieces):
        sums.add(part)
    return sums.curves(1.0 / rate)[0]


def sd_of(found: Coefficient) -> float:
    assert found.low is not None
    assert found.high is not None
    return (found.high - found.low) / 3.92


def test_it_is_that_of_allantools() -> None:
    n, x = 1234567890, []
    for _ in range(1000):
        x.append(n / 2147483647)
        n = 16807 * n % 2147483647
    lines = (ROOT / "tests/goldens/allantools/oadev.csv").read_text().splitlines()
    golden = {int(r["m"]): float(r["deviation"]) for r in csv.DictReader(lines[2:])}
    found = curve(np.array(x), pieces=7, rate=1.0)
    assert list(found.tau) == [m for m in golden if m <= found.tau[-1]]
    assert len(found.tau) >= 8
    for tau, deviation in zip(found.tau, found.deviation, strict=True):
        # Beyond 64 samples the overlap goes in steps of 1/64.
        assert deviation == pytest.approx(golden[int(tau)], rel=1e-12 if tau <= 64 else 0.01)
    assert found.deviation[0] == pytest.approx(2.922319e-01, abs=5e-8)  # NIST SP 1065, table 31


@pytest.mark.slow
def test_white_noise_is_told_with_its_doubt_and_nothing_else() -> None:
    z, named = [], 0
    for seed in range(30):
        found = identify(curve(0.1 * np.random.default_rng(seed).normal(size=20_000)))
        assert found.white.value is not None
        z.append((found.white.value - 0.1 / np.sqrt(HZ)) / sd_of(found.white))
        named += sum(c.value is not None for c in (found.instability, found.walk, found.ramp))
    assert 0.7 < np.std(z) < 1.4
    assert abs(np.mean(z)) < 0.7
    assert named == 0


@pytest.mark.slow
def test_a_walk_is_told_where_the_recording_is_long_enough() -> None:
    z = []
    for seed in range(12):
        found = identify(curve(walk(seed, 60_000)))
        assert found.instability.value is None
        if found.walk.value is not None:  # ten minutes are few: an instability may do as much
            z.append((found.walk.value - 2e-3) / sd_of(found.walk))
    assert len(z) >= 9
    assert 0.5 < np.std(z) < 1.5


def walk(seed: int, count: int) -> np.ndarray:
    """White noise of 0.1 and a walk of K = 2e-3 unit/s/sqrt(Hz)."""
    rng = np.random.default_rng(seed)
    white = 0.1 * rng.normal(size=count)
    return white + np.cumsum(2e-3 / np.sqrt(HZ) * rng.normal(size=count))


@pytest.mark.slow
def test_a_walk_that_is_not_told_has_a_limit_above_it() -> None:
    """One of 95 %, in five seconds, which show none."""
    low = 0
    for seed in range(60):
        found = identify(curve(walk(seed, 500)))
        assert found.walk.value is None
        low += found.walk.below < 2e-3
    assert low <= at_most(60, 0.05).most


def test_flicker_is_a_bias_instability() -> None:
    rng = np.random.default_rng(5)
    count, flicker = 150_000, np.zeros(150_000)
    for octave in range(13):  # Lorentzians an octave apart are 1/f
        keep = np.exp(-1.0 / 2.0**octave)
        drive = np.sqrt(1.0 - keep**2) * rng.normal(size=count)
        own = np.empty(count)
        last = 0.0
        for i, d in enumerate(drive):
            last = keep * last + d
            own[i] = last
        flicker += own
    # Their sum has S(f) = 1 / (ln 2 f), so σ² = 2 ln 2 h = 2 and B² = 2 π / (2 ln 2).
    want = 4e-3 * np.sqrt(np.pi / np.log(2.0))
    found = identify(curve(0.05 * rng.normal(size=count) + 4e-3 * flicker))
    assert found.instability.value == pytest.approx(want, rel=0.2)
    assert found.walk.value is None


def test_rests_that_still_settle_are_left_out() -> None:
    rng = np.random.default_rng(6)
    sums, loud = AllanSums(3), (0, 3, 4, 9)
    for k in range(14):
        rest = 0.1 * rng.normal(size=(400, 3))
        if k in loud:
            sway = np.exp(-np.arange(400) / 150.0) * np.sin(np.arange(400) / 8.0)
            rest[:, k % 3] += 0.4 * sway
        sums.add(rest)
        sums.cut()
    quiet = sums.quiet(1.0 / HZ)
    assert list(np.flatnonzero(~quiet)) == list(loud)
    for curve_of_axis in sums.curves(1.0 / HZ, quiet):
        found = identify(curve_of_axis).white
        assert found.value == pytest.approx(0.1 / np.sqrt(HZ), rel=0.06)


def test_a_motion_that_begins_is_no_noise() -> None:
    """It begins before it shows, so that the ends of rests are louder: by a half at some τ."""
    rng = np.random.default_rng(3)
    x = np.clip((np.arange(380 * 24) % 380 - 250.0 + rng.uniform()) / 130.0, 0.0, 1.0)
    turn = 30.0 * x**2 * (1.0 - x) ** 2 * 1.5
    angle = np.cumsum(turn) / RATE
    force = STANDARD_GRAVITY * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    force += rng.normal(scale=0.03, size=force.shape)
    rate = turn[:, None] * np.array([0.6, -0.6, 0.6]) + rng.normal(scale=1e-3, size=force.shape)
    made = recording_of(np.arange(x.size) / RATE, force, rate, hz=RATE)
    (gyro,) = (s for s in noise_at_rest([made], still_segments(made)) if s.unit == "rad/s")
    assert np.mean([axis.white.value for axis in gyro.axes]) == pytest.approx(1e-4, rel=0.02)
    assert all(axis.white.low < 1e-4 < axis.white.high for axis in gyro.axes)
