"""A calibration by later rests: what changed, in per cent, its false alarms and power as stated,
and the rests it asks for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import ncx2

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.check import MANY, Measured, check, next_rests
from imucalib.calibration.checking.misfit import (
    Misfits,
    change_question,
    gyro_rest,
    misfits_of,
)
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.triads import Triad
from imucalib.calibrators.lab.bench import RawUnit, observations_of
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.errors import UsageError
from worlds.instrument import DEG, MG, Array, G, four, vectors
from worlds.stated import made

#: What matters of each kind, in its unit.
MATTERS = {"bias": 2.0, "scale": 2.0, "mounting": 0.1}


def rests(reading: Array) -> PositionTable:
    columns = dict(zip("xyz", reading.T, strict=True))
    return PositionTable(columns, {}, {}, np.arange(len(reading)), "", "")


def misfits(calibration: Calibration, reading: Array) -> Misfits:
    by_size = LabRequest(reference="norm", gravity=G, sigma=1.0)
    data = observations_of(rests(reading), RawUnit("m/s2", 1.0, ""), by_size)
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
    question = change_question(found, MATTERS)
    assert question.dof == pytest.approx(12.0)
    assert question.answer().nothing == pytest.approx(_unchanged(found, 12.0), abs=0.03)


def _unchanged(found: Misfits, dof: float) -> float:
    """Probability by its definition, over all sets: every size of each kind, of each rest that may
    be off and of the noise, by multivariate t of a noise that so many degrees of freedom told."""
    sizes = 2.0 ** np.arange(-2.0, 7.0)
    prior = np.exp(-0.5 * (np.maximum(np.log(sizes), 0.0) / np.log(3.5)) ** 2)
    prior, squares, n = prior / prior.sum(), sizes**2, found.value.size
    # Of each component: prior odds and covariance of every way to act, the first that it does not.
    bias, scale = (2.0 * found.changes[kind] for kind in ("bias", "scale"))
    off = (2.0 * MG) ** 2 * np.einsum("ki,kj->kij", np.eye(n), np.eye(n))
    ways = [
        (np.r_[1.0, 0.2 * prior], np.multiply.outer(np.r_[0.0, squares], bias @ bias.T)),
        (np.r_[1.0, 0.2 * prior], np.multiply.outer(np.r_[0.0, squares], scale @ scale.T)),
        (np.r_[1.0, 0.05 * np.repeat(prior, n) / n],
         np.concatenate([np.zeros((1, n, n)), np.multiply.outer(squares, off).reshape(-1, n, n)])),
        (np.r_[1.0, 0.05 * prior], 1.0 + np.r_[0.0, squares]),
    ]  # fmt: skip
    (p, a), (q, b), (r, c), (s, larger) = ways
    change = a[:, None, None] + b[:, None] + c
    whole = larger[:, None, None] * (found.covariance + change[..., None, :, :])
    odds = np.einsum("i,j,k,l->ijkl", p, q, r, s)
    square = np.einsum("i,...ij,j->...", found.value, np.linalg.inv(whole), found.value)
    log_t = -0.5 * np.linalg.slogdet(whole)[1] - 0.5 * (dof + n) * np.log1p(square / dof)
    weight = 2.4 * odds * np.exp(log_t)
    weight[0, 0, 0, 0] /= 2.4
    return float(weight[0, 0, 0, 0] / weight.sum())


def test_a_change_is_found_named_and_sized() -> None:
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
        assert sensor.causes == (kind,)
        assert sensor.answer.of(kind) > 0.95
        own = sensor.sizes[kind]
        assert np.abs(own.value - size) / own.sd == pytest.approx(0.0, abs=3.5)


@pytest.mark.slow
@pytest.mark.parametrize("dof", [4.0, 40.0])
def test_false_alarms_and_power_stated_are_had(dof: float) -> None:
    """Also where the noise was estimated from four numbers: the statement moves with it."""
    rng = np.random.default_rng(int(dof) + 1)
    force, noise, runs = vectors(*four(rng)), 0.4, 300
    # The calibration: every axis up and down at 0.4 mg.
    sign = np.concatenate([np.eye(3), -np.eye(3)])
    design = np.column_stack([sign, 1e3 * np.abs(sign)])
    covariance = noise**2 * np.linalg.inv(design.T @ design)
    base, rows = misfits(made(np.zeros(6), covariance, dof, noise=noise), force), force / G
    question = change_question(base, MATTERS)
    worst, stated = question.worst(0), MATTERS["bias"] * question.find_detectable(0)
    assert worst is not None
    sign = np.sign(base.changes["bias"] @ rows.T).diagonal()
    alarms = hits = 0
    for _ in range(runs):
        q = rng.chisquare(dof) / dof
        theta = rng.multivariate_normal(np.zeros(6), covariance)
        for size in (0.0, stated * np.sqrt(q)):  # the statement goes with the noise estimate
            off = rows @ (size * worst - theta[:3]) - 1e3 * rows**2 @ theta[3:]
            value = MG * (off + noise * rng.standard_normal(len(rows)))
            own = base.noise["reading"]
            noise_ = {"reading": replace(own, covariance=q * own.covariance)}
            seen = replace(base, value=value * sign, noise=noise_, parameters=q * base.parameters)
            found = change_question(seen, MATTERS).answer().told
            alarms, hits = alarms + (found and not size), hits + (found and size > 0.0)
    assert alarms / runs <= question.false_alarm() + 0.03
    # What other suspects tell of it, more noise above all, adds to what is stated of it alone.
    assert 0.80 - 0.06 < hits / runs < 0.80 + 0.12


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
    assert np.isinf(found.sensors[0].sizes["bias"].seen)
    plan = found.following
    assert plan is not None
    assert plan.enough
    assert plan.seen["bias"] <= 1.5
    # The axis that no rest has shown comes first, and what is proposed does what it says.
    assert abs(plan.direction[0][2]) > 0.5
    added = np.concatenate(
        [force, G * plan.direction / np.linalg.norm(plan.direction, axis=1)[:, None]]
    )
    wanted = {"bias": 1.5, "scale": 1.5, "mounting": 0.1}
    again = 1.5 * change_question(misfits(calibration, added), wanted).find_detectable(0)
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
    """Student's t of the mean against the calibration's rests: beyond a limit, above or below."""
    rng = np.random.default_rng(2)
    triad = Triad("a", np.eye(3), np.eye(3), np.zeros(3), np.eye(3), np.zeros(3), np.eye(12), 1.0,
                  1.0)  # fmt: skip
    rate = DEG * (0.02 * rng.normal(size=(5, 3)) + [0.0, -0.03, 0.01])
    found = gyro_rest(triad, rate, {"count": 8})
    assert found is not None
    deg = rate / DEG
    sd = deg.std(axis=0, ddof=1) * np.sqrt(1 / 5 + 1 / 8)
    np.testing.assert_allclose(found.sd, sd)
    drawn = deg.mean(axis=0) + sd * rng.standard_t(4, size=(200_000, 3))
    for limit in (0.02, 0.04):
        share = np.mean(np.abs(drawn).max(axis=1) > limit)
        assert found.chance_beyond(limit) == pytest.approx(share, abs=0.005)
    alone = gyro_rest(triad, rate, {})
    assert alone is not None
    np.testing.assert_allclose(alone.sd, deg.std(axis=0, ddof=1) * np.sqrt(2 / 5))
    rate[:3] = np.nan
    assert gyro_rest(triad, rate, {"count": 8}) is None


OWN, READING = 0.3, 1.0  # mg


def power(number: int, change: float, bar: float) -> float:
    """Chance that `number` rests all round tell a bias (mg): each sees a third of its square,
    beside the calibration's own doubt; told from a square on, the noise known."""
    var = READING**2 * 3.0 / number + OWN**2
    return float(ncx2.sf(bar, 3, change**2 / var))


def test_how_many_rests_would_do() -> None:
    """More than a dozen, and as many as a bias asks for that is told from a square of 10 to 16 on
    (chances of 2 % and 0.1 %)."""
    calibration = made(np.zeros(6), np.diag([OWN**2] * 3 + [1e-8] * 3), 1e4)
    noise, limits = check_noise(calibration), {"bias": 1.8}
    none = misfits(calibration, G * np.eye(3)).take(np.zeros(0, np.intp))
    matters = {"bias": 1.8, "scale": 1.8, "mounting": 0.1}
    found = next_rests(calibration, none, noise, limits, matters)
    assert not found.enough
    least, most = (next(n for n in MANY if power(n, 1.8, bar) >= 0.8) for bar in (10.0, 16.0))
    assert found.many is not None
    assert least <= found.many <= most
