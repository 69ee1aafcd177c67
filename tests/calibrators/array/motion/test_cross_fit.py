"""The array's search: what took no part says, and readings that are late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import undrawn_board
from imucalib.calibrators.array.board.moving import Moving
from imucalib.calibrators.array.board.rests import RestFit
from imucalib.calibrators.array.motion.ages import beats, estimate_clock, find_voting
from imucalib.calibrators.array.motion.closed_loop import Gained, difference_of_medians
from imucalib.calibrators.array.motion.laws import array_catalogue
from imucalib.calibrators.array.motion.setup import Setup, array_setup, part_of
from imucalib.calibrators.array.motion.state import start_state
from imucalib.calibrators.array.motion.terms import (
    BoardMotion,
    Term,
    board_motion,
    columns_of,
    determine,
    evaluate_lags,
    lag_motion,
    rest_terms,
)
from imucalib.core.effect import Channel
from imucalib.estimators.array.sample_age import SampleAge
from imucalib.posterior.held_out import Difference
from imucalib.recording.recording import Recording
from worlds.array_stories import BOARD, moving_of, planted_log

SAMPLES = 300


def looked_at(recording: Recording) -> tuple[Moving, RestFit, Setup]:
    moving, rests = moving_of(recording)
    setup = array_setup(moving, BOARD, SAMPLES)
    assert setup is not None
    return moving, rests, setup


@pytest.fixture(scope="module")
def clean() -> Recording:
    return planted_log("clean", 7)[0]


@pytest.mark.slow
def test_halves_share_no_sample_and_no_clock_learns_of_them(clean: Recording) -> None:
    recording = planted_log("clock skew, 1 ms", 3)[0]
    moving, rests, setup = looked_at(recording)
    one, two = part_of(setup, setup.first), part_of(setup, ~setup.first)
    assert not set(one.rows[one.inner]) & set(two.rows[two.inner])
    assert np.array_equal(
        np.sort(np.concatenate([one.rows[one.inner], two.rows[two.inner]])),
        setup.rows[setup.inner],
    )
    state = start_state(one, rest_terms(rests))
    before = estimate_clock(state)
    silent = two.rows[two.inner][find_voting(two)]
    rate = moving.rate.copy()
    rate[silent] *= 1.5
    after = estimate_clock(replace(state, setup=replace(one, moving=replace(moving, rate=rate))))
    assert before is not None
    assert after is not None
    assert np.array_equal(before.frequency, after.frequency)
    assert len(silent) > 30


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [8, 20])
@pytest.mark.parametrize("ratio", [1.0, 0.85])
def test_the_interval_of_medians_holds_the_truth(ratio: float, blocks: int) -> None:
    rng = np.random.default_rng(5)
    block, inside = np.repeat(np.arange(blocks), 30), 0
    for _ in range(400):
        # Blocks differ by more than their samples say: as fast and slow motion do, and in what
        # they gain.
        level = np.exp(0.8 * rng.normal(size=blocks))[block][:, None]
        gained = ratio * np.exp(0.1 * rng.normal(size=blocks))[block][:, None]
        before = np.abs(rng.normal(size=(len(block), 6))) * level
        after = np.abs(rng.normal(size=(len(block), 6))) * level * gained
        found = difference_of_medians(before, after, block, 2)
        truth = found.before * (1.0 - ratio)
        inside += found.low < truth < found.high
    # At 95 % and wider: fewer than 365 by chance in one of 1e4, where 92 % hold in two of three.
    assert inside >= 365


@pytest.mark.parametrize(
    ("channels", "force", "rate", "holds"),
    [
        (("acceleration", "angular_rate"), 0.1, 0.2, True),
        (("acceleration", "angular_rate"), 0.001, -0.12, False),
        (("acceleration", "angular_rate"), -0.006, 0.95, True),  # a hair beside twenty times
        (("angular_rate",), 0.001, -0.12, False),  # what others gain is no proof of it
        (("angular_rate",), -0.001, 0.12, True),  # nor is what it does not act on against it
    ],
)
def test_each_sensors_own_error_decides(
    channels: tuple[Channel, ...], force: float, rate: float, holds: bool
) -> None:
    """By what effects on some channels have gained of errors of one."""
    one, two = (Difference(1.0, 1.0 - gain, gain, gain, 8) for gain in (force, rate))
    assert Gained(one, two).select_deciding(channels).holds == holds


def swung(t: Array) -> BoardMotion:
    """All packages alike: ω and the force swing at 4 and 3 Hz."""
    w, f = 8.0 * np.pi, 6.0 * np.pi
    rate, force = (np.sin(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    spin, jerk = (x * np.cos(x * t)[:, None] * [1.0, -2.0, 0.5] for x in (w, f))
    every = (len(t), 2, 3)
    found = board_motion(
        undrawn_board(2), t, order=t, rate=rate, spin=spin,
        force=np.broadcast_to(force[:, None], every), jerk=np.broadcast_to(jerk[:, None], every),
    )  # fmt: skip
    beside = np.ones((len(t), 2), dtype=np.bool_)
    beside[0, 0] = beside[-1, 1] = False
    return found.set_courses(beside)


def term(name: str, delay: list[float]) -> Term:
    return Term(name, array_catalogue()[name], None, np.eye(len(delay)), np.array(delay),
                np.ones(len(delay)))  # fmt: skip


T = np.arange(200) / 200.0


def test_what_acts_on_a_late_reading_acts_on_what_was_then() -> None:
    here, late = swung(T), [0.0, 1.5]
    own, other = term("gyro_delay_each", late), term("accelerometer_delay", [0.5, 0.0])
    np.testing.assert_allclose(own.lag(here)[0], [0.0, 1.5e-3], atol=1e-15)
    np.testing.assert_allclose(other.lag(here)[0], [0.5e-3, 0.0], atol=1e-15)
    then = lag_motion([own, other], here)
    earlier = swung(T - 1.5e-3).truth.turning.rate[:, 1]
    # The third order is left: (8 π 1.5e-3)³ / 6 of the swing.
    turning = then.truth_of("angular_rate").turning.rate
    # Of the first and the last only what lies to one side is known.
    np.testing.assert_allclose(turning[1:-1, 1], earlier[1:-1], atol=2e-5)
    np.testing.assert_allclose(turning[:, 0], here.truth.turning.rate[:, 0], atol=1e-15)
    felt = then.truth_of("acceleration").force
    due = swung(T - 0.5e-3).truth.force[:, 0]
    np.testing.assert_allclose(felt[1:-1, 0], due[1:-1], atol=1e-6)
    more = evaluate_lags([own, other], here)
    np.testing.assert_allclose(here.truth.turning.rate + more.rate, turning, atol=1e-12)
    np.testing.assert_allclose(here.truth.force + more.acceleration, felt, atol=1e-12)
    scale = columns_of(array_catalogue()["gyro_scale"], then).basis[1]
    np.testing.assert_allclose(np.einsum("tii->ti", scale)[1:-1], 0.01 * earlier[1:-1], atol=2e-7)


@pytest.mark.parametrize("tau", [0.6, 4.0, 16.0])
def test_a_low_pass_weakens_what_is_fast(tau: float) -> None:
    """Against H = 1 / (1 + i ω τ) of each swing; the first samples have no past to be filtered."""
    here = swung(T)
    slow = [term("gyro_low_pass_each", [0.0, tau]), term("accelerometer_low_pass", [tau, 0.0])]
    then = lag_motion(slow, here)
    rate, force = then.truth_of("angular_rate").turning.rate, then.truth_of("acceleration").force
    for found, hz in ((rate[:, 1], 4.0), (force[:, 0], 3.0)):
        w = 2.0 * np.pi * hz
        y = np.imag(np.exp(1j * w * T) / (1.0 + 1e-3j * w * tau))
        late = T > 0.1
        np.testing.assert_allclose(found[late, 1], -2.0 * y[late], atol=2e-4)
    np.testing.assert_allclose(rate[:, 0], here.truth.turning.rate[:, 0], atol=1e-15)
    np.testing.assert_allclose(force[:, 1], here.truth.force[:, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "beside", "rank"),
    [
        ("gyro_delay_each", "accelerometer_delay", 1),
        ("gyro_delay_each", "accelerometer_low_pass", 1),
        ("gyro_delay_each", "gyro_scale", 2),
        ("accelerometer_delay", "gyro_delay", 1),
        ("accelerometer_delay", "gyro_sample_age", 2),
    ],
)
def test_the_time_itself_is_nobodys(name: str, beside: str, rank: int) -> None:
    """What all delays of both kinds of sensor share is no delay at all; a clock's beat has none."""
    other = term(beside, [0.0, 0.0])
    found = determine(name, array_catalogue()[name], None, 1e4 * np.eye(2), [other])
    assert found.live.shape[1] == rank
    if rank == 1:
        assert abs(found.live.sum()) < 1e-12


def test_a_beat_is_the_steady_part_of_a_sawtooth() -> None:
    t = 3.0 + np.arange(0.0, 20.0, 0.01)
    turns = -0.7 * (t - 3.0) + 0.3 + 0.05 * np.sin(2.0 * np.pi * t / 10.0)
    wave = np.stack([turns - np.floor(turns) - 0.5, np.zeros(t.size)], axis=1)
    one, none = beats(SampleAge(wave, np.array([-0.7, np.nan])), t, np.arange(t.size))
    assert none is None
    assert one is not None
    assert (one.hz, one.at_s) == (pytest.approx(-0.7, abs=0.002), 3.0)
    assert one.phase_turns == pytest.approx(0.3, abs=0.03)
    assert one.wander_turns == pytest.approx(0.05 / np.sqrt(2.0), rel=0.15)
