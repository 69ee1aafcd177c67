"""The test of a calibration by later rests: its level, its power, what it states and asks for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats
from scipy.stats import chi2, ncx2

from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.calibration.checking.check import Measured, checked
from imucalib.calibration.checking.misfit import Misfits, Part, gyro_rest, misfits_of
from imucalib.calibration.checking.next_rests import MANY, next_rests
from imucalib.calibration.checking.noise import KNOWN, Scatter, check_noise
from imucalib.calibration.checking.statistic import ANYTHING, Statistic
from imucalib.calibration.triads import Triad
from imucalib.calibrators.lab.bench import still_observations
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.errors import UnreadableInput
from worlds.instrument import MG, Array, G, four, vectors
from worlds.stated import made

NAMES = tuple(f"{what}_{axis}" for what in ("bias", "scale") for axis in "xyz")


def six(bias: Array, scale: Array, covariance: Array, noise: float, dof: float) -> Calibration:
    """A calibration of three biases (mg) and scales, whose readings scatter by `noise` mg."""
    values, sd = np.concatenate([bias, scale]), np.sqrt(np.diag(covariance))
    effects = ("bias",) * 3 + ("scale",) * 3
    units = ("mg",) * 3 + ("1",) * 3
    return Calibration(
        calibrator="lab",
        parameters=tuple(
            StoredParameter(n, e, "sensor", float(v), float(s), u)
            for n, e, v, s, u in zip(NAMES, effects, values, sd, units, strict=True)
        ),
        covariance=covariance,
        raw_unit="m/s2", raw_to_si=1.0, gravity=G, status="ok",
        facts={"noise": {"reading_mg": noise, "reading_sd_mg": noise / np.sqrt(2.0 * dof)}},
    )  # fmt: skip


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
    calibration = six(bias, scale, root @ root.T, 0.3, 12.0)
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
    made = six(np.zeros(3), np.zeros(3), covariance, noise, dof)
    reference = Statistic(misfits(made, force))
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
    calibration = six(np.zeros(3), np.zeros(3), np.diag([0.01] * 3 + [1e-8] * 3), 0.2, 30.0)
    for kind, size in (("bias", np.array([2.0, -1.0, 0.5])), ("scale", np.array([3.0, 0.0, -2.0]))):
        moved = force + MG * size if kind == "bias" else force * (1.0 + 1e-3 * size)
        moved = moved + 0.2 * MG * rng.standard_normal(force.shape)
        found = checked(
            calibration, [Measured(misfits(calibration, moved))], check_noise(calibration), {}
        )
        assert (found.verdict, found.exit_code) == ("changed", 1)
        (sensor,) = found.sensors
        assert sensor.causes[0] == kind
        test = sensor.tests[kind]
        assert np.abs(test.size - size) / test.sd == pytest.approx(0.0, abs=3.5)


def test_two_rests_are_undecided_with_the_rests_to_add() -> None:
    rng = np.random.default_rng(5)
    calibration = six(np.zeros(3), np.zeros(3), np.diag([0.01] * 3 + [1e-8] * 3), 0.2, 30.0)
    force = G * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    reading = force + 0.1 * MG * rng.standard_normal(force.shape)
    found = checked(
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


STATED_G = 9.80665


STATED_MG, DEG = 1e-3 * STATED_G, np.pi / 180.0


def file(noise: dict[str, float] | None = None, **facts: object) -> SimpleNamespace:
    return SimpleNamespace(facts={"noise": noise or {}, **facts}, triads=facts.pop("triads", ()))


def test_a_stated_sd_tells_its_freedom_by_its_own_sd() -> None:
    """var(s) = s² / 2ν; without one it is taken at its word."""
    found = check_noise(file({"reading_mg": 0.4, "reading_sd_mg": 0.1}))  # type: ignore[arg-type]
    assert found.reading.sd == pytest.approx(0.4 * STATED_MG)
    assert found.reading.dof == pytest.approx(8.0)
    assert check_noise(file({"reading_mg": 0.4})).reading.dof == KNOWN  # type: ignore[arg-type]
    wide = check_noise(file({"reading_mg": 0.4, "reading_sd_mg": 0.4}))  # type: ignore[arg-type]
    assert wide.reading.dof == 1.0
    given = check_noise(file(), reading=0.7 * STATED_MG, session={"bias": 0.5})  # type: ignore[arg-type]
    assert given.reading == Scatter(0.7 * STATED_MG)
    assert given.session == {"bias": Scatter(0.5)}
    with pytest.raises(UnreadableInput, match="does not state the noise"):
        check_noise(file())  # type: ignore[arg-type]


def test_a_settings_scatter_holds_its_own_doubt() -> None:
    """sd √(1 + 1/2ν), and four degrees of freedom at least."""
    block = {"reading_mg": 0.4, "tool_face_setting_deg": 0.2, "tool_face_setting_sd_deg": 0.1,
             "inclination_setting_deg": 0.3, "inclination_setting_sd_deg": 0.05}  # fmt: skip
    found = check_noise(file(block)).setting  # type: ignore[arg-type]
    assert found["tool-face setting"].sd == pytest.approx(0.2 * DEG * np.sqrt(1.25))
    assert found["tool-face setting"].dof == 4.0
    assert found["inclination setting"].dof == pytest.approx(18.0)
    assert "tilt" not in found


def test_rests_of_an_array_have_their_freedom() -> None:
    triads = (1, 2, 3, 4)
    rests = {"count": 14, "residual_m_per_s2": 0.003}
    noise = {"shared_mg": 0.3, "shared_sd_mg": 0.1, "shared_memory_positions": 5.0}
    made = SimpleNamespace(facts={"rests": rests, "noise": noise}, triads=triads)
    found = check_noise(made)  # type: ignore[arg-type]
    # A reading's own noise and what its neighbours share, by Satterthwaite.
    own, shared = Scatter(0.003, 3.0 * 4 * 14 - 2 * 14 - 12 * 4), Scatter(0.3 * STATED_MG, 4.5)
    whole = np.hypot(own.sd, shared.sd)
    assert found.reading.sd == pytest.approx(whole)
    due = whole**4 / (own.sd**4 / own.dof + shared.sd**4 / shared.dof)
    assert found.reading.dof == pytest.approx(due)
    assert (found.share, found.memory) == pytest.approx(((shared.sd / whole) ** 2, 5.0))
    alone = check_noise(SimpleNamespace(facts={"rests": rests}, triads=triads))  # type: ignore[arg-type]
    assert alone.reading == own
    few = SimpleNamespace(facts={"rests": {**rests, "count": 2}}, triads=triads)
    assert check_noise(few).reading.dof == 1.0  # type: ignore[arg-type]


def stated_misfits(value: np.ndarray, columns: dict[str, np.ndarray], dof: float = 9.0) -> Misfits:
    n = len(value)
    rng = np.random.default_rng(1)
    root = 1e-3 * (np.eye(n) + 0.3 * rng.normal(size=(n, n)))
    return Misfits(
        value=value, noise={"reading": Part(root @ root.T, dof)}, session={},
        jacobian=np.zeros((n, 2)), parameters=np.zeros((2, 2)), changes=columns,
        owner=np.arange(n), label=("",) * n, force=np.zeros((n, 3)), directed=False,
    )  # fmt: skip


def world(seed: int = 0) -> tuple[Misfits, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = 8
    columns = {
        "bias": STATED_MG * rng.normal(size=(n, 3)),
        "scale": STATED_MG * rng.normal(size=(n, 3)),
    }
    made = stated_misfits(2e-3 * rng.normal(size=n), columns)
    return made, made.covariance


def test_every_family_is_an_f_test_and_least_squares() -> None:
    made, v = world()
    w = np.linalg.inv(v)
    found = Statistic(made, draws=200).tested()
    for name, x in made.changes.items():
        size = np.linalg.solve(x.T @ w @ x, x.T @ w @ made.value)
        np.testing.assert_allclose(found[name].size, size)
        np.testing.assert_allclose(found[name].sd, np.sqrt(np.diag(np.linalg.inv(x.T @ w @ x))))
        power = size @ x.T @ w @ made.value
        assert found[name].rank == 3
        assert found[name].f == pytest.approx(power / 3.0)
        assert found[name].p == pytest.approx(stats.f.sf(power / 3.0, 3, made.dof))
        left = (made.value @ w @ made.value - power) / 5.0
        assert found[name].rest == pytest.approx(stats.f.sf(left, 5, made.dof))
    whole = made.value @ w @ made.value / 8.0
    assert found[ANYTHING].p == pytest.approx(stats.f.sf(whole, 8, made.dof))
    both = np.concatenate(list(made.changes.values()), axis=1)
    fitted = made.value @ w @ both @ np.linalg.solve(both.T @ w @ both, both.T @ w @ made.value)
    rest = (made.value @ w @ made.value - fitted) / 2.0
    one = Statistic(made, draws=200)
    assert one.rest_of_all() == pytest.approx(stats.f.sf(rest, 2, made.dof))
    direction = one.worst("bias")
    assert direction is not None
    gram = made.changes["bias"].T @ w @ made.changes["bias"]
    assert direction @ gram @ direction == pytest.approx(np.linalg.eigvalsh(gram)[0])


def test_the_smallest_p_is_held_against_that_of_unchanged_sensors() -> None:
    made, _ = world(3)
    one = Statistic(made, draws=4000)
    own = min(test.p for test in one.tested().values())
    assert own < one.p() < min(1.0, 3.0 * own + 2.0 / 4000)
    # A change of the size that is said to be seen is found in nine of ten.
    size = one.seen("scale")
    direction = one.worst("scale")
    assert direction is not None
    assert one.power("scale", size * direction) == pytest.approx(0.9, abs=0.01)
    assert one.power("scale", 0.0 * direction) == pytest.approx(0.05, abs=0.001)
    flat = stated_misfits(made.value, {"bias": made.changes["bias"] * [1.0, 1.0, 0.0]})
    assert Statistic(flat, draws=50).seen("bias") == np.inf
    assert np.isnan(Statistic(flat, draws=50).tested()["bias"].size).all()
    assert Statistic(flat, draws=50).tested()["bias"].rank == 2


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
