"""What motion that took no part says: nothing of it trains, and a loss takes the steps back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.loop.ages import found_clock, voting
from imucalib.calibrators.array.loop.cross_fit import Gained, difference_of_medians
from imucalib.calibrators.array.loop.search import start_state
from imucalib.calibrators.array.loop.setup import Setup, array_setup, part_of
from imucalib.calibrators.array.loop.terms import rest_terms
from imucalib.calibrators.array.moving import Moving
from imucalib.calibrators.array.rests import RestFit
from imucalib.loop.held_out import Difference
from imucalib.recording.recording import Recording
from worlds.array_stories import BOARD, moving_of, planted_log

SAMPLES = 300


def looked_at(recording: Recording) -> tuple[Moving, RestFit, Setup]:
    moving, rests = moving_of(recording)
    setup = array_setup(moving, BOARD, SAMPLES, robust=True)
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
    before = found_clock(state)
    silent = two.rows[two.inner][voting(two)]
    rate = moving.rate.copy()
    rate[silent] *= 1.5
    after = found_clock(replace(state, setup=replace(one, moving=replace(moving, rate=rate))))
    assert before is not None
    assert after is not None
    assert np.array_equal(before.frequency, after.frequency)
    assert len(silent) > 30


@pytest.mark.slow
@pytest.mark.parametrize("blocks", [8, 20])
@pytest.mark.parametrize("ratio", [1.0, 0.85])
def test_the_interval_of_medians_holds_the_truth(ratio: float, blocks: int) -> None:
    rng = np.random.default_rng(5)
    block, inside, wide = np.repeat(np.arange(blocks), 30), 0, []
    for _ in range(400):
        # Blocks differ by more than their samples say: as fast and slow motion do, and in what
        # they gain.
        level = np.exp(0.8 * rng.normal(size=blocks))[block][:, None]
        gained = ratio * np.exp(0.1 * rng.normal(size=blocks))[block][:, None]
        before = np.abs(rng.normal(size=(len(block), 6))) * level
        after = np.abs(rng.normal(size=(len(block), 6))) * level * gained
        found = difference_of_medians(before, after, block, 2)
        truth = found.before * (1.0 - ratio)
        inside += abs(found.gain - truth) < found.gain - found.plain_low
        wide.append(found.low < truth < found.high)
    # At 95 %: fewer than 365 by chance in one of 1e4, where 92 % hold in two of three.
    assert 365 <= inside <= 398
    assert np.mean(wide) >= np.mean(inside / 400.0)


@pytest.mark.parametrize(
    ("force", "rate", "refutes"),
    [
        ((-0.03, -0.01, 0.02), (-2e-4, -1e-5, 2e-4), False),  # losses that noise may make
        ((-0.03, -0.01, 0.02), (-4e-4, -2e-4, -1e-5), False),  # a sure one, of a thousandth
        ((-2e-6, -1e-6, 1e-6), (-0.3, -0.2, -0.1), True),  # a sure one that counts
        ((0.02, 0.1, 0.2), (-0.3, -0.2, -0.1), False),  # beside a gain
    ],
)
def test_a_loss_refutes_where_it_is_sure_and_counts(
    force: tuple[float, ...], rate: tuple[float, ...], refutes: bool
) -> None:
    """Lower edge, middle and upper edge of the gain, of an error of one."""
    one, two = (Difference(1.0, 1.0 - gain, low, high, low, 8) for low, gain, high in (force, rate))
    assert Gained(one, two, (one, two)).refutes == refutes
