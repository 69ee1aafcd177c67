"""What the array's search decides by, in small sums: halves, moves, other noise, clocks."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from imucalib.calibrators.array.loop import noise_tests as tests_of
from imucalib.calibrators.array.loop.ages import Ages, _learning, beats
from imucalib.calibrators.array.loop.catalogue import array_catalogue
from imucalib.calibrators.array.loop.search import Search
from imucalib.calibrators.array.loop.setup import stretches, with_neighbours
from imucalib.calibrators.array.loop.terms import determined
from imucalib.calibrators.array.loop.worth import TAU, Beside, _most_likely
from imucalib.calibrators.array.simulation import (
    LogPlan,
    MotionPlan,
    simulated_log,
    simulated_samples,
)
from imucalib.estimators.array.noise import SensorNoise, Squares
from imucalib.estimators.array.reduced import Alone
from imucalib.estimators.array.sample_age import SampleAge, fit_sample_age
from imucalib.loop.evidence import Candidate, Score
from worlds.twisted_board import BOARD

Array = NDArray[np.float64]
DEG = np.pi / 180.0


def normal(seed: int, p: int = 3) -> tuple[Array, Array, Array]:
    """Columns X (40, p), data y with them in it, and their products as `Alone` holds them."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(40, p))
    return x, x @ rng.normal(size=p) + rng.normal(size=40), np.zeros(0)


def by_evidence(x: Array, y: Array) -> Array:
    """Ridge estimate at the size under which the data are likeliest, by dense matrices."""
    nats = [stats.multivariate_normal(cov=np.eye(40) + t**2 * x @ x.T).logpdf(y) for t in TAU]
    tau = TAU[int(np.argmax(nats))]
    return np.linalg.solve(x.T @ x + np.eye(x.shape[1]) / tau**2, x.T @ y)


def test_the_likeliest_size_shrinks_an_estimate() -> None:
    for seed in range(4):
        x, y, _ = normal(seed)
        found = _most_likely(Alone(x.T @ x, x.T @ y))
        np.testing.assert_allclose(found, by_evidence(x, y), rtol=1e-6)


def beside(one: tuple[Array, Array], two: tuple[Array, Array]) -> Beside:
    first, second = (Alone(x.T @ x, x.T @ y) for x, y in (one, two))
    x, y = (np.concatenate(v) for v in zip(one, two, strict=True))
    carry = np.arange(12.0).reshape(4, 3) / 10.0
    return Beside(Alone(x.T @ x, x.T @ y), (first, second), x.T @ x, carry, 4)


def test_each_half_gains_by_what_the_other_has_estimated() -> None:
    """Half the fall of the sum of squares."""
    (x1, y1, _), (x2, y2, _) = normal(1), normal(2)
    gains = beside((x1, y1), (x2, y2)).held_out
    for gain, x, y, value in ((gains[0], x2, y2, by_evidence(x1, y1)),
                              (gains[1], x1, y1, by_evidence(x2, y2))):  # fmt: skip
        assert gain == pytest.approx(0.5 * (y @ y - np.sum((y - x @ value) ** 2)), rel=1e-6)


def test_a_candidate_moves_the_positions_by_what_they_carry_of_it() -> None:
    (x1, y1, _), (x2, y2, _) = normal(1), normal(2)
    found = beside((x1, y1), (x2, y2))
    moved = found.carry @ _most_likely(found.whole)
    assert found.moves == pytest.approx(np.sqrt(np.mean(moved**2)))


def test_a_curve_keeps_the_directions_that_the_base_leaves() -> None:
    """At least a fifth of their square."""
    total = np.diag([4.0, 4.0, 4.0, 0.0])
    one = Alone(np.diag([4.0, 0.81, 0.79, 0.0]), np.zeros(4))
    kept = Beside(one, (one, one), total, np.zeros((3, 4)), 3).apart
    np.testing.assert_allclose(kept @ kept.T, np.diag([1.0, 1.0, 0.0, 0.0]), atol=1e-9)


def test_noise_that_neighbours_share_leaves_fewer_samples() -> None:
    bare = Candidate("a", "effect", np.zeros((0, 1)))
    score = Score(bare, 12.0, 0.001, 9, 1.0, 5.0, 0.1)
    contest = SimpleNamespace(beyond_chance=lambda draws: 11.0)
    found = SimpleNamespace(null=np.array([1.0, 3.9, 4.0, 4.1, 9.0]), draws=5, contest=contest)
    late = Search.by_chance(found, score, 3.0)
    assert (late.evidence, late.p) == (4.0, 4.0 / 6.0)


def test_nothing_is_simulated_for_what_chance_cannot_reach() -> None:
    bare = Candidate("a", "effect", np.zeros((0, 1)))
    contest = SimpleNamespace(beyond_chance=lambda draws: 11.0)
    found = SimpleNamespace(draws=99, contest=contest)  # without data that lack nothing
    assert Search.by_chance(found, Score(bare, 12.0, 1.0, 99, 1.0, 5.0, 0.1)).p == 0.01


def state(values: Array, interval: float = 0.01, weight: float = 4.0) -> SimpleNamespace:
    """Residuals (T, K, 3) of both sensors; every sample but the ends is looked at."""
    n, k, _ = values.shape
    t = interval * np.arange(n)
    ones = np.full((n, k), weight)
    return SimpleNamespace(
        setup=SimpleNamespace(inner=np.arange(1, n - 1), t=t, interval=interval),
        sampled=SimpleNamespace(
            off=SimpleNamespace(rate=values, acceleration=values),
            weights=SimpleNamespace(rate=ones, acceleration=ones),
        ),
    )


def test_memory_is_the_correlation_of_neighbours() -> None:
    rng = np.random.default_rng(0)
    values = np.zeros((2000, 4, 3))
    for t in range(1, 2000):
        values[t] = 0.6 * values[t - 1] + rng.normal(size=(4, 3))
    rho, numbers = tests_of.memory(state(values), gyro=True)  # type: ignore[arg-type]
    inner = values[1:-1]
    due = np.sum(inner[1:] * inner[:-1]) / (np.sum(inner[1:] ** 2) + np.sum(inner[:-1] ** 2)) * 2.0
    assert rho == pytest.approx(due)
    assert numbers == 3 * 3 * 1997
    assert tests_of.memory(state(values), gyro=False)[1] == 3 * 2 * 1997  # type: ignore[arg-type]
    factor = tests_of.shared_by_neighbours(state(values), gyro=True)  # type: ignore[arg-type]
    assert factor == pytest.approx((1.0 + rho) / (1.0 - rho))
    white = rng.normal(size=(2000, 4, 3))
    assert tests_of.shared_by_neighbours(state(white), gyro=True) == 1.0  # type: ignore[arg-type]
    steady = np.ones((2000, 4, 3))
    assert tests_of.shared_by_neighbours(state(steady), gyro=True) == pytest.approx(39.0)  # type: ignore[arg-type]
    assert tests_of.memory(state(values[:12]), gyro=True) == (0.0, 0)  # type: ignore[arg-type]
    apart = state(values)
    apart.setup.t = 2.0 * apart.setup.t
    assert tests_of.memory(apart, gyro=True) == (0.0, 0)  # type: ignore[arg-type]


def test_noise_of_another_shape_is_told_by_its_likelihood() -> None:
    """Tails and growth against white noise of the likeliest size, by scipy."""
    rng = np.random.default_rng(1)
    speed = rng.uniform(1.0, 10.0, 400)
    values = 0.1 * rng.standard_normal((400, 3, 3)) / np.sqrt(rng.chisquare(5, (400, 3, 1)) / 5)
    values = values * np.sqrt(1.0 + (0.3 * speed) ** 2)[:, None, None]
    square = Squares(np.sum(values**2, axis=2), np.full(3, 3.0))
    plain = SensorNoise(0.1, 0.0, np.inf, np.ones(3))
    found = {t.driver: t for t in tests_of._shapes("gyroscope", square, speed, plain)}
    white = stats.norm.logpdf(values, scale=np.sqrt(np.mean(values**2))).sum()
    unit = 1.0 / np.median(speed)
    nats = []
    for c in (0.3, 1.0, 3.0):
        grown = np.sqrt(1.0 + (c * unit * speed) ** 2)[:, None, None]
        size = np.sqrt(np.mean((values / grown) ** 2))
        nats.append(stats.norm.logpdf(values, scale=size * grown).sum() - white)
    assert found["|ω|"].evidence == pytest.approx(max(nats))
    assert found["|ω|"].strength == pytest.approx(np.sqrt(2.0 * max(nats)))

    def tails(nu: float) -> float:
        one = stats.multivariate_t(shape=np.eye(3), df=nu)
        return max(float(one.logpdf(values / s).sum()) - values.size * np.log(s)
                   for s in np.geomspace(0.05, 0.5, 400))  # fmt: skip

    due = max(tails(nu) for nu in (5.0, 15.0, 50.0)) - white
    assert found[""].evidence == pytest.approx(due, rel=1e-3)
    shaped = replace(plain, growth=0.3, freedom=5.0)
    assert tests_of._shapes("gyroscope", square, speed, shaped) == []


def test_a_beat_is_the_steady_part_of_a_sawtooth() -> None:
    t = 3.0 + np.arange(0.0, 20.0, 0.01)
    turns = -0.7 * (t - 3.0) + 0.3 + 0.05 * np.sin(2.0 * np.pi * t / 10.0)
    wave = np.stack([turns - np.floor(turns) - 0.5, np.zeros(t.size)], axis=1)
    clock = SampleAge(wave, np.array([-0.7, np.nan]), np.zeros(2))
    one, none = beats(Ages(wave, np.ones(t.size, bool), clock), t)
    assert none is None
    assert one is not None
    assert one.frequency == pytest.approx(-0.7, abs=0.002)
    assert one.phase == pytest.approx(0.3, abs=0.03)
    assert one.at == 3.0
    assert one.wander == pytest.approx(0.05 / np.sqrt(2.0), rel=0.15)


@pytest.mark.parametrize("frequency", [1.3, -0.8])
def test_the_ages_of_readings_are_told_from_what_they_are_late_by(frequency: float) -> None:
    """Off by -a dω/dt, a a sawtooth of 2 ms; a delay of the gyro's own beside it is no beat."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 20.0, 0.01)
    slope = 300.0 * np.stack([np.sin(w * t + p) for w, p in ((7.0, 0.0), (11.0, 1.0), (5.0, 2.0))],
                             axis=1)  # fmt: skip
    turns = frequency * t + 0.2
    wave = turns - np.floor(turns) - 0.5
    off = np.zeros((t.size, 2, 3))
    off[:, 0] = -(2e-3 * wave + 1e-3)[:, None] * slope
    off += 0.003 * rng.standard_normal(off.shape)
    found = fit_sample_age(t, off, slope, np.arange(5, t.size - 5))
    assert found.frequency[0] == pytest.approx(frequency, abs=0.01)
    assert np.isnan(found.frequency[1])
    assert not found.wave[:, 1].any()
    assert found.line[0] > 30.0 > found.line[1]
    away = np.mod(found.wave[:, 0] - wave + 0.5, 1.0) - 0.5
    assert np.median(np.abs(away)) < 0.03


def moving(good: Array, t: Array) -> SimpleNamespace:
    return SimpleNamespace(t=t, good=good, interval=0.01)


def test_neighbours_are_informative_and_at_the_usual_interval() -> None:
    t = 0.01 * np.arange(12.0)
    t[7:] += 0.004  # a gap of 1.4 intervals
    good = np.array([0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11])
    assert with_neighbours(moving(good, t)).tolist() == [1, 2, 8, 9, 10]  # type: ignore[arg-type]
    near = np.arange(100, 400)
    assert stretches(near, 300) is near
    some = stretches(near, 160)
    assert len(some) == 160
    starts = some[np.append(True, np.diff(some) > 1)]
    assert len(starts) <= 10
    assert (some[0], some[-1]) == (100, 399)


def test_clocks_are_learned_where_the_search_does_not_look() -> None:
    """Outside of it where that is at least half; else groups of eight learn and vote in turn."""
    t = 0.01 * np.arange(100.0)
    part = moving(np.arange(100), t)
    near, learning, voting = _learning(SimpleNamespace(apart=np.arange(48)), part)  # type: ignore[arg-type]
    assert near.tolist() == list(range(1, 99))
    assert learning.tolist() == list(range(48, 99))
    assert voting.all()
    _, learning, voting = _learning(SimpleNamespace(apart=np.arange(52)), part)  # type: ignore[arg-type]
    assert learning.tolist() == [k for k in range(1, 99) if (k // 8) % 2 == 0]
    assert np.flatnonzero(voting).tolist() == [k for k in range(100) if (k // 8) % 2 == 1]


def test_simulated_samples_scatter_as_the_paper_plans_them() -> None:
    """Forces of a rigid body in random motion; gyros as good as the mean of all."""
    r = 0.02 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    plan = MotionPlan(samples=3000, sigma=0.04, sigma_gyro=0.06)
    data = simulated_samples(r, plan, np.random.default_rng(0))
    assert data.rate.std() == pytest.approx(1000.0 * DEG, rel=0.03)
    np.testing.assert_allclose(data.rate_precision, np.eye(3) * 4.0 / (0.06 * DEG) ** 2)
    np.testing.assert_allclose(data.sigma, 0.04)
    # What places the rates leave of the differences is dω/dt and noise: three unknowns a sample.
    w = data.rate
    out = np.cross(w[:, None], np.cross(w[:, None], r))
    rest = (data.acceleration - out) - (data.acceleration - out)[:, :1]
    skew = np.concatenate([np.array([np.cross(e, p) for e in np.eye(3)]).T for p in r[1:]])
    spin = np.linalg.lstsq(skew, rest[:, 1:].reshape(3000, 9).T, rcond=None)[0].T
    assert spin.std() == pytest.approx(35_000.0 * DEG, rel=0.03)
    left = rest[:, 1:].reshape(3000, 9) - spin @ skew.T
    assert 0.04 < left.std() < 0.1
    assert (data.acceleration - out)[:, 0].std() == pytest.approx(20.0, rel=0.03)


def test_a_simulated_log_rests_and_twists_as_planned() -> None:
    plan = LogPlan(poses=4, pose_seconds=2.0, seconds=30.0, twist=300.0, gyro_gain=0.0, gain=0.0,
                   planted={"gyro_scale": 0.1, "gyro_delay": 0.02})  # fmt: skip
    made = simulated_log(BOARD, plan, np.random.default_rng(2))
    one = made.recording.channels[f"{BOARD.imus[0]}/acceleration"]
    rate = made.recording.channels[f"{BOARD.imus[0]}/angular_rate"]
    assert len(one.t) == 38 * 100
    rests = one.values[:800].reshape(4, 200, 3)
    np.testing.assert_allclose(rests.std(axis=1), 0.04, rtol=0.2)
    size = np.linalg.norm(rests.mean(axis=1), axis=1)
    np.testing.assert_allclose(size, 9.80665, atol=1.0)  # biases of 0.3 m/s²
    turning = rate.values[900:3700]
    assert turning.std() == pytest.approx(1.1 * 300.0 * DEG, rel=0.1)
    away = made.positions - (BOARD.positions - BOARD.positions[0])
    assert away[1:].std() == pytest.approx(2.8e-4, rel=0.4)
    same = simulated_log(BOARD, replace(plan, planted={}), np.random.default_rng(2))
    plain = same.recording.channels[f"{BOARD.imus[0]}/angular_rate"].values
    bias = plain[:800].mean(axis=0)
    late = 1.1 * (plain[900:3600] - bias)
    found = rate.values[900:3600] - rate.values[:800].mean(axis=0)
    np.testing.assert_allclose(found[2:], late[:-2], atol=0.05)


@pytest.mark.filterwarnings("error")
def test_a_term_of_which_the_data_determine_nothing_moves_in_silence() -> None:
    effect = array_catalogue()["gyro_delay_each"]
    term = determined("gyro_delay_each", effect, None, np.zeros((8, 8)))
    moved = term.moved(np.zeros(0), np.zeros(0))
    assert moved.value.shape == moved.sd.shape == (0,)
