"""What a check takes from a calibration's file, and what a test of it says, by their equations."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from imucalib.calibration.checking.e_value import paid
from imucalib.calibration.checking.misfit import (
    KNOWN,
    Misfits,
    Part,
    Scatter,
    check_noise,
    gyro_rest,
)
from imucalib.calibration.checking.statistic import ANYTHING, Statistic
from imucalib.calibration.triads import Triad
from imucalib.errors import UnreadableInput

G = 9.80665
MG, DEG = 1e-3 * G, np.pi / 180.0


def file(noise: dict[str, float] | None = None, **facts: object) -> SimpleNamespace:
    return SimpleNamespace(facts={"noise": noise or {}, **facts}, triads=facts.pop("triads", ()))


def test_a_stated_sd_tells_its_freedom_by_its_own_sd() -> None:
    """var(s) = s² / 2ν; without one it is taken at its word."""
    found = check_noise(file({"reading_mg": 0.4, "reading_sd_mg": 0.1}))  # type: ignore[arg-type]
    assert found.reading.sd == pytest.approx(0.4 * MG)
    assert found.reading.dof == pytest.approx(8.0)
    assert check_noise(file({"reading_mg": 0.4})).reading.dof == KNOWN  # type: ignore[arg-type]
    wide = check_noise(file({"reading_mg": 0.4, "reading_sd_mg": 0.4}))  # type: ignore[arg-type]
    assert wide.reading.dof == 1.0
    given = check_noise(file(), reading=0.7 * MG, session={"bias": 0.5})  # type: ignore[arg-type]
    assert given.reading == Scatter(0.7 * MG)
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
    own, shared = Scatter(0.003, 3.0 * 4 * 14 - 2 * 14 - 12 * 4), Scatter(0.3 * MG, 4.5)
    whole = np.hypot(own.sd, shared.sd)
    assert found.reading.sd == pytest.approx(whole)
    due = whole**4 / (own.sd**4 / own.dof + shared.sd**4 / shared.dof)
    assert found.reading.dof == pytest.approx(due)
    assert found.shared is not None
    assert (found.shared.share, found.shared.memory) == pytest.approx(
        ((shared.sd / whole) ** 2, 5.0)
    )
    alone = check_noise(SimpleNamespace(facts={"rests": rests}, triads=triads))  # type: ignore[arg-type]
    assert alone.reading == own
    few = SimpleNamespace(facts={"rests": {**rests, "count": 2}}, triads=triads)
    assert check_noise(few).reading.dof == 1.0  # type: ignore[arg-type]


def misfits(value: np.ndarray, columns: dict[str, np.ndarray], dof: float = 9.0) -> Misfits:
    n = len(value)
    rng = np.random.default_rng(1)
    root = 1e-3 * (np.eye(n) + 0.3 * rng.normal(size=(n, n)))
    return Misfits(
        value=value, reading=Part(root @ root.T, dof), setting={}, session={},
        jacobian=np.zeros((n, 2)), parameters=np.zeros((2, 2)), changes=columns,
        owner=np.arange(n), label=("",) * n, force=np.zeros((n, 3)), directed=False,
    )  # fmt: skip


def world(seed: int = 0) -> tuple[Misfits, np.ndarray]:
    rng = np.random.default_rng(seed)
    n = 8
    columns = {"bias": MG * rng.normal(size=(n, 3)), "scale": MG * rng.normal(size=(n, 3))}
    made = misfits(2e-3 * rng.normal(size=n), columns)
    return made, made.reading.covariance


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
    assert not one.saturated
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
    flat = misfits(made.value, {"bias": made.changes["bias"] * [1.0, 1.0, 0.0]})
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


def test_the_stake_of_a_look_is_its_share() -> None:
    """0.7 for the first, 0.3 / j (j - 1) for the j-th; each pays 1 / 0.7 α."""
    unit = 1.0 / (0.7 * 0.05)
    assert paid([0.0244]) == pytest.approx(unit)
    assert paid([0.0246]) == 0.0
    assert paid([0.5, 0.00524]) == pytest.approx(unit)
    assert paid([0.5, 0.00526]) == 0.0
    assert paid([0.5, 0.5, 0.00174]) == pytest.approx(unit)
    assert paid([0.5, 0.5, 0.00176]) == 0.0
    assert paid([0.01, 0.001, 0.001]) == pytest.approx(3.0 * unit)
