"""The test of a calibration by later rests: its level, its power, what it states and asks for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.stats import chi2, ncx2

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.check import Measured, check
from imucalib.calibration.checking.misfit import Misfits, gyro_rest, misfits_of
from imucalib.calibration.checking.next_rests import MANY, next_rests
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.checking.statistic import ANYTHING, Statistic
from imucalib.calibration.triads import Triad
from imucalib.calibrators.lab.bench import still_observations
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.errors import UsageError
from worlds.instrument import DEG, MG, Array, G, four, vectors
from worlds.stated import made


def rests(reading: Array) -> PositionTable:
    columns = dict(zip("xyz", reading.T, strict=True))
    return PositionTable(columns, {}, {}, np.arange(len(reading)), "", "")


def misfits(calibration: Calibration, reading: Array) -> Misfits:
    data = still_observations(rests(reading), reading, G, sigma=1.0)
    return misfits_of(calibration, data, check_noise(calibration))[0]


def test_misfits_and_their_covariance_are_the_physics_written_again() -> None:
    rng = np.random.default_rng(3)
    bias, scale = np.array([12.0, -7.0, 30.0]), np.array([4e-3, -6e-3, 2e-3])
    root = np.diag([0.2] * 3 + [3e-4] * 3) @ (np.eye(6) + 0.2 * rng.standard_normal((6, 6)))
    calibration = made(np.r_[bias, scale], root @ root.T, 12.0, noise=0.3)
    force = vectors(*four(rng))
    reading = force * (1.0 + scale) + bias * MG + 0.5 * MG * rng.standard_normal((4, 3))
    found = misfits(calibration, reading)
    # Along the reading's gradient of |f|: what is left when the attitude is free.
    corrected = (reading - bias * MG) / (1.0 + scale)
    u = corrected / np.linalg.norm(corrected, axis=1, keepdims=True)
    along = u / (1.0 + scale)
    length = np.linalg.norm(along, axis=1)
    value = (np.linalg.norm(corrected, axis=1) - G) / length
    slope = np.column_stack([MG * along, along * G * u]) / length[:, None]
    expected = (0.3 * MG) ** 2 * np.eye(4) + slope @ root @ root.T @ slope.T
    assert np.abs(found.value) == pytest.approx(np.abs(value), rel=1e-3)
    assert np.diag(found.covariance) == pytest.approx(np.diag(expected), rel=1e-6)
    assert found.dof == pytest.approx(12.0)
    t = value @ np.linalg.inv(expected) @ value / 4
    assert Statistic(found).tested()[ANYTHING].p == pytest.approx(stats.f.sf(t, 4, 12), rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("dof", [4.0, 40.0])
def test_the_level_and_the_power_stated_are_had(dof: float) -> None:
    """Also where the noise was estimated from four numbers: the statement moves with it."""
    rng = np.random.default_rng(int(dof) + 1)
    force, noise, runs = vectors(*four(rng)), 0.4, 300
    # The calibration: every axis up and down at 0.4 mg.
    sign = np.concatenate([np.eye(3), -np.eye(3)])
    design = np.column_stack([sign, 1e3 * np.abs(sign)])
    covariance = noise**2 * np.linalg.inv(design.T @ design)
    own = made(np.zeros(6), covariance, dof, noise=noise)
    reference = Statistic(misfits(own, force))
    worst, stated = reference.worst("bias"), reference.seen("bias")
    assert worst is not None
    base, rows = reference.misfits, force / G
    alarms = hits = 0
    for _ in range(runs):
        q = rng.chisquare(dof) / dof
        theta = rng.multivariate_normal(np.zeros(6), covariance)
        for size in (0.0, stated * np.sqrt(q)):  # the statement goes with the noise estimate
            off = rows @ (size * worst - theta[:3]) - 1e3 * rows**2 @ theta[3:]
            value = MG * (off + noise * rng.standard_normal(len(rows)))
            sign = np.sign(base.changes["bias"] @ rows.T).diagonal()
            own = base.noise["reading"]
            noise_ = {"reading": replace(own, covariance=q * own.covariance)}
            seen = replace(base, value=value * sign, noise=noise_, parameters=q * base.parameters)
            found = Statistic(seen, draws=1500).p() <= 0.05
            alarms, hits = alarms + (found and not size), hits + (found and size > 0.0)
    assert alarms / runs == pytest.approx(0.05, abs=0.03)
    assert hits / runs == pytest.approx(0.90, abs=0.05)


def test_a_shift_is_found_named_and_sized() -> None:
    rng = np.random.default_rng(8)
    force = np.concatenate([vectors(*four(rng)) for _ in range(3)])
    calibration = made(np.zeros(6), np.diag([0.01] * 3 + [1e-8] * 3), 30.0, noise=0.2)
    for kind, size in (("bias", np.array([2.0, -1.0, 0.5])), ("scale", np.array([3.0, 0.0, -2.0]))):
        moved = force + MG * size if kind == "bias" else force * (1.0 + 1e-3 * size)
        moved = moved + 0.2 * MG * rng.standard_normal(force.shape)
        found = check(
            calibration, [Measured(misfits(calibration, moved))], check_noise(calibration), {}
        )
        assert (found.verdict, found.exit_code) == ("changed", 1)
        (sensor,) = found.sensors
        assert sensor.causes[0] == kind
        test = sensor.tests[kind]
        assert np.abs(test.size - size) / test.sd == pytest.approx(0.0, abs=3.5)


def test_two_rests_are_undecided_with_the_rests_to_add() -> None:
    rng = np.random.default_rng(5)
    calibration = made(np.zeros(6), np.diag([0.01] * 3 + [1e-8] * 3), 30.0, noise=0.2)
    force = G * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    reading = force + 0.1 * MG * rng.standard_normal(force.shape)
    found = check(
        calibration, [Measured(misfits(calibration, reading))], check_noise(calibration),
        {"mg": 1.5},
    )  # fmt: skip
    assert (found.verdict, found.exit_code) == ("undecided", 5)
    assert np.isinf(found.sensors[0].seen["bias"])
    plan = found.following
    assert plan is not None
    assert plan.enough
    assert plan.seen["bias"] <= 1.5
    # The axis that no rest has shown comes first, and what is proposed does what it says.
    assert abs(plan.direction[0][2]) > 0.5
    added = np.concatenate(
        [force, G * plan.direction / np.linalg.norm(plan.direction, axis=1)[:, None]]
    )
    again = Statistic(misfits(calibration, added)).seen("bias")
    assert again == pytest.approx(plan.seen["bias"], rel=0.1)


def file(noise: dict[str, float] | None = None, **facts: object) -> SimpleNamespace:
    return SimpleNamespace(facts={"noise": noise or {}, **facts}, triads=facts.pop("triads", ()))


def test_a_readings_noise_has_the_freedom_of_its_parts() -> None:
    """var(s) = s² / 2ν of a stated sd; with the rests' own and what neighbours share,
    Satterthwaite's."""
    noise = {"reading_mg": 0.4, "reading_sd_mg": 0.1}
    assert check_noise(file(noise)).reading.dof == pytest.approx(8.0)  # type: ignore[arg-type]
    shared = {"shared_mg": 0.3, "shared_sd_mg": 0.1, "shared_memory_positions": 5.0}
    rests = {"count": 14, "residual_m_per_s2": 0.003}
    found = check_noise(file(shared, rests=rests, triads=(1, 2, 3, 4)))  # type: ignore[arg-type]
    parts = np.array([0.003**2, (0.3 * MG) ** 2])
    dof = np.array([3.0 * 4 * 14 - 2 * 14 - 12 * 4, 4.5])
    assert found.reading.sd == pytest.approx(np.sqrt(parts.sum()))
    assert found.reading.dof == pytest.approx(parts.sum() ** 2 / np.sum(parts**2 / dof))
    assert (found.share, found.memory) == pytest.approx((parts[1] / parts.sum(), 5.0))
    with pytest.raises(UsageError, match="does not state the noise"):
        check_noise(file())  # type: ignore[arg-type]


def test_a_gyroscope_is_tested_by_the_scatter_between_its_rests() -> None:
    """Student's t of the mean against the calibration's rests, the smallest p times three."""
    rng = np.random.default_rng(2)
    triad = Triad("a", np.eye(3), np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), np.eye(12), 1.0,
                  1.0)  # fmt: skip
    rate = DEG * (0.02 * rng.normal(size=(5, 3)) + [0.0, -0.03, 0.01])
    found = gyro_rest(triad, rate, {"count": 8})
    assert found is not None
    deg = rate / DEG
    sd = deg.std(axis=0, ddof=1) * np.sqrt(1 / 5 + 1 / 8)
    each = 2.0 * stats.t.sf(np.abs(deg.mean(axis=0)) / sd, 4)
    np.testing.assert_allclose(found.sd, sd)
    assert found.p == pytest.approx(min(1.0, 3.0 * each.min()))
    alone = gyro_rest(triad, rate, {})
    assert alone is not None
    np.testing.assert_allclose(alone.sd, deg.std(axis=0, ddof=1) * np.sqrt(2 / 5))
    rate[:3] = np.nan
    assert gyro_rest(triad, rate, {"count": 8}) is None


OWN, READING = 0.3, 1.0  # mg


def power(number: int, change: float) -> float:
    """Chance that `number` rests all round show a bias (mg): each sees a third of its square,
    beside the calibration's own doubt; by the bias alone at 5 %, the noise known."""
    var = READING**2 * 3.0 / number + OWN**2
    return float(ncx2.sf(chi2.isf(0.05, 3), 3, change**2 / var))


def test_how_many_rests_would_do() -> None:
    """More than a dozen, and as many as the bias alone says, or the next number: other kinds of
    change are asked for too."""
    calibration = made(np.zeros(6), np.diag([OWN**2] * 3 + [1e-8] * 3), 1e4)
    noise = check_noise(calibration)
    none = misfits(calibration, G * np.eye(3)).take(np.zeros(0, np.intp))
    found = next_rests(calibration, none, noise, {"bias": 1.8}, directed=False)
    assert not found.enough
    least = next(n for n in MANY if power(n, 1.8) >= 0.9)
    assert found.many in MANY[MANY.index(least) : MANY.index(least) + 2]
