"""Calibrations compared, each number by its equation: what differs, attitude, date, power-ups."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibration.calibration import Calibration
from imucalib.calibration.checking.noise import sessions_of
from imucalib.calibration.comparison.agreement import (
    Basis,
    agreement,
    basis_of,
    estimate_excess,
)
from imucalib.calibration.comparison.compare import (
    array_meanings,
    compare,
    due,
    slope_of,
    with_power_ups,
)
from imucalib.core.fit import StoredParameter
from imucalib.core.sphere import even_directions
from imucalib.errors import UnreadableInput, UsageError
from imucalib.posterior.closed_loop.changes import NOISE
from imucalib.report.comparison import compose_comparison_document
from imucalib.units import DEG
from worlds.instrument import MG, Array, G, rotation
from worlds.stated import made


def root(rng: np.random.Generator, size: int) -> Array:
    units = np.array([0.3] * 3 + [4e-4] * 3 + [0.02] * 3)[:size]
    return units[:, None] * (np.eye(size) + 0.3 * rng.standard_normal((size, size)))


NAMES = tuple(f"{kind}_{axis}" for kind in ("bias", "scale", "mounting") for axis in "xyz")


@pytest.mark.slow
@pytest.mark.parametrize("dof", [6.0, 1e5])
def test_calibrations_that_scatter_as_they_state_agree(dof: float) -> None:
    """Also where their sds come from few readings each, and a bias of seven sds is told."""
    rng = np.random.default_rng(int(dof) % 97)
    half, told, found, runs = root(rng, 6), 0, 0, 60
    for _ in range(runs):
        scale = rng.chisquare(dof, 3) / dof if dof < 100 else np.ones(3)
        value = rng.standard_normal((3, 6)) @ half.T
        one = Basis(NAMES[:6], ("",) * 6, value, scale[:, None, None] * (half @ half.T),
                    np.full(3, dof), "")  # fmt: skip
        told += agreement(one).answer.told
        value[2, 0] += 7.0 * np.sqrt((half @ half.T)[0, 0])
        found += agreement(one).odd == (2,)
    assert told <= 0.15 * runs
    assert found >= 0.85 * runs


def test_the_difference_at_the_worst_attitude_is_the_plain_physics() -> None:
    rng = np.random.default_rng(1)
    half = root(rng, 9)
    first = np.concatenate([[10.0, -5.0, 3.0], [2e-3, -3e-3, 1e-3], [0.5, -0.3, 0.2]])
    other = first + np.array([1.5, 0.0, -1.0, 1e-3, 0.0, -5e-4, 0.1, 0.0, 0.2])
    files = [made(t, half @ half.T) for t in (first, other)]
    found = compare(files, ["a", "b"], {})
    assert found.basis.words == "All hold the same parameters."
    u = even_directions(400)

    def forward(t: Array, f: Array) -> Array:
        return f @ rotation(t[6:]).T * (1.0 + t[3:6]) + t[:3] * MG

    def back(t: Array, r: Array) -> Array:
        return ((r - t[:3] * MG) / (1.0 + t[3:6])) @ rotation(t[6:])

    force = back(other, forward(first, G * u))
    size = (np.linalg.norm(force, axis=1) - G) / MG
    turn = np.degrees(
        np.linalg.norm(force - u * np.einsum("ni,ni->n", force, u)[:, None], axis=1) / G
    )
    mg, deg = found.meanings
    assert mg.value == pytest.approx(np.abs(size).max(), rel=1e-6)
    assert deg.value == pytest.approx(turn.max(), rel=1e-6)
    # Its sd, by draws of both.
    at = int(np.argmax(u @ mg.attitude))
    drawn = []
    for _ in range(1500):
        a, b = (t + half @ rng.standard_normal(9) for t in (first, other))
        drawn.append(np.linalg.norm(back(b, forward(a, G * u[at : at + 1]))))
    assert np.std(drawn) / MG == pytest.approx(mg.sd, rel=0.08)


def test_beyond_the_limit_and_beyond_chance_are_two_things() -> None:
    sharp, vague = np.diag([0.01] * 3 + [1e-8] * 3), np.diag([9.0] * 3 + [1e-5] * 3)
    away = np.array([2.0, 0, 0, 0, 0, 0])
    for covariance, limit, verdict, code in (
        (sharp, 1.0, "differ", 1), (sharp, 5.0, "agree", 0),
        (vague, 1.0, "undecided", 5), (vague, 5.0, "agree", 0),
    ):  # fmt: skip
        files = [made(t, covariance) for t in (np.zeros(6), away)]
        found = compare(files, ["a", "b"], {"mg": limit})
        assert (found.verdict, found.exit_code) == (verdict, code)
        assert found.differ == (covariance is sharp)


def test_the_file_that_differs_from_the_others_is_named() -> None:
    rng = np.random.default_rng(2)
    half = root(rng, 6)
    files = [made(half @ rng.standard_normal(6), half @ half.T) for _ in range(5)]
    names = list("abcde")
    assert compare(files, names, {}).odd == ()
    files[3] = made(np.array([8.0, 0, 0, 0, 0, 0]), half @ half.T)
    found = compare(files, names, {})
    assert (found.odd, found.exit_code) == (("d",), 1)
    assert "d" in {names[k] for k in found.meanings[0].pair}
    page = compose_comparison_document(found, [Path(f"{name}.yaml") for name in names])
    assert page.title == "Comparison of 5 calibrations"
    assert "Unlike the others: d." in [str(text.text) for text in page.card.found]


def test_the_scatter_between_calibrations_and_its_interval() -> None:
    rng = np.random.default_rng(3)
    true, inside, estimates = 0.5, 0, []
    for _ in range(400):
        variance = rng.uniform(0.01, 0.09, 8)
        value = np.sqrt(variance + true**2) * rng.standard_normal(8)
        found = estimate_excess(value, variance)
        estimates.append(found.sd**2)
        inside += found.low <= true <= found.high
    assert inside / 400 == pytest.approx(0.95, abs=0.03)
    assert np.mean(estimates) == pytest.approx(true**2, rel=0.12)


def test_the_interval_of_a_drift_holds_in_95_of_100() -> None:
    days = np.array([0.0, 100.0, 200.0, 300.0, 400.0])
    rng, covered = np.random.default_rng(4), 0
    for _ in range(400):
        noisy = 0.003 * days + np.sqrt(0.04 + 0.25) * rng.standard_normal(5)
        slope = slope_of(days, noisy, np.full(5, 0.04))
        covered += abs(slope.value - 0.003) <= slope.half
    assert covered / 400 == pytest.approx(0.95, abs=0.035)


def test_other_effects_are_compared_by_what_they_do() -> None:
    covariance = np.diag([0.04] * 3 + [1e-7] * 3)
    theta = np.array([5.0, -3.0, 1.0, 1e-3, 2e-3, -1e-3])
    plain = made(theta, covariance)
    more = Calibration(**{
        **vars(plain),
        "parameters": (*plain.parameters, StoredParameter("cross_yx", "non_orthogonality", "sensor",
                       0.0, 1e-4, "1"), StoredParameter("cross_zx", "non_orthogonality", "sensor",
                       0.0, 1e-4, "1"), StoredParameter("cross_zy", "non_orthogonality", "sensor",
                       0.0, 1e-4, "1")),
        "covariance": np.diag([0.04] * 3 + [1e-7] * 3 + [1e-8] * 3),
    })  # fmt: skip
    found = compare([plain, more], ["a", "b"], {})
    assert "different effects" in found.basis.words
    assert found.verdict == "agree"
    assert found.meanings[0].value == pytest.approx(0.0, abs=1e-6)
    sd = np.sqrt(found.basis.covariance[0].diagonal())
    assert sd[:3] == pytest.approx(0.2, rel=1e-3)  # the offsets are the biases


def test_what_cannot_be_compared_is_refused() -> None:
    covariance = np.diag([0.04] * 3 + [1e-7] * 3)
    one = made(np.zeros(6), covariance)
    with pytest.raises(UsageError, match="nothing to compare"):
        compare([one], ["a"], {})
    with pytest.raises(UnreadableInput, match="no uncertainty"):
        compare([one, made(np.zeros(6), 0.0 * covariance)], ["a", "b"], {})
    tied = made(np.zeros(9), np.diag([0.04] * 3 + [1e-7] * 3 + [1e-4] * 3))
    with pytest.raises(UsageError, match="not all tie a frame"):
        compare([one, tied], ["a", "b"], {"deg": 0.1})
    assert any("only b ties" in n for n in compare([one, tied], ["a", "b"], {}).notes)
    with pytest.raises(UsageError, match="3 dates"):
        compare([one, one], ["a", "b"], {}, ("2026-01-01",) * 3)
    with pytest.raises(UsageError, match="no date"):
        compare([one, one], ["a", "b"], {}, ("2026-01-01", "soon"))
    far = replace(one, gravity=G + 0.01)
    assert any("gravities" in n for n in compare([one, far], ["a", "b"], {}).notes)


#: mg: scatter of the bias between power-ups, and of a calibration's own.
SCATTER, OWN = 0.5, 0.1


def several(rng: np.random.Generator, days: int) -> Calibration:
    """A mean of so many power-ups, whose scatter it knows from as many."""
    theta, stated = np.zeros(6), SCATTER * (rng.chisquare(3 * (days - 1)) / 3 / (days - 1)) ** 0.5
    theta[:3] = np.hypot(SCATTER / days**0.5, OWN) * rng.standard_normal(3)
    theta[3:] = 1e-4 * rng.standard_normal(3)
    covariance = np.diag([stated**2 / days + OWN**2] * 3 + [1e-8] * 3)
    block = {
        "sessions": [str(k) for k in range(days)],
        "scatter": [{"what": "session bias", "sd": stated}],
    }
    one = made(theta, covariance, 60.0)
    return replace(one, facts={**one.facts, "between_sessions": block})


def one_day(rng: np.random.Generator) -> Calibration:
    theta = np.concatenate([
        np.hypot(SCATTER, OWN) * rng.standard_normal(3), 1e-4 * rng.standard_normal(3),
    ])  # fmt: skip
    return made(theta, np.diag([OWN**2] * 3 + [1e-8] * 3), 60.0)


@pytest.mark.parametrize("days", [2, 5])
def test_another_days_calibration_is_seldom_told_to_differ(days: int) -> None:
    """Without the scatter it was 40 to 60."""
    rng, told = np.random.default_rng(days), 0
    for _ in range(25):
        files, power_ups, _ = with_power_ups([several(rng, days), one_day(rng)], {})
        basis = basis_of(files, np.full(2, 60.0), framed=False, power_ups=power_ups)
        told += agreement(basis).answer.told
    # 6 or more of 25 by chance, where 5 % are told: 0.1 %.
    assert told <= 5


def test_a_scatter_that_is_given_is_in_every_sd_of_one_power_up() -> None:
    rng = np.random.default_rng(4)
    files = [one_day(rng), one_day(rng)]
    plain = compare(files, ["a", "b"], {})
    found = compare(files, ["a", "b"], {}, between=sessions_of(["0.7mg"]))
    bias = np.einsum("kii->ki", found.basis.covariance)[:, :3]
    np.testing.assert_allclose(bias, OWN**2 + 0.7**2)
    np.testing.assert_allclose(found.basis.covariance[:, 3:], plain.basis.covariance[:, 3:])
    assert found.agreement.answer.nothing > plain.agreement.answer.nothing
    assert any("0.7 mg of bias, as given" in note for note in found.notes)
    assert any("--between-sessions" in note for note in plain.notes)


def basis(seed: int = 0, m: int = 4) -> Basis:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(m, 2, 2))
    covariance = roots @ roots.swapaxes(1, 2) + 0.3 * np.eye(2)
    dof = np.array([9.0, 20.0, 14.0, 30.0])[:m]
    return Basis(("a", "b"), ("mg", "1"), 2.0 * rng.normal(size=(m, 2)), covariance, dof, "")


def test_all_agree_by_generalised_least_squares() -> None:
    made = basis()
    white = [np.linalg.inv(np.linalg.cholesky(c)) for c in made.covariance]
    y = np.concatenate([w @ v for w, v in zip(white, made.value, strict=True)])
    x = np.concatenate(white)
    mean, rest = np.linalg.lstsq(x, y, rcond=None)[:2]
    found = agreement(made)
    np.testing.assert_allclose(found.mean, mean)
    np.testing.assert_allclose(found.mean_sd, np.sqrt(np.diag(np.linalg.inv(x.T @ x))))
    assert found.chi2 == pytest.approx(rest[0])
    assert found.dof == 6
    assert found.z_rms == pytest.approx(np.sqrt(rest[0] / 6.0))
    # Each against the mean of the others.
    for k in range(4):
        others = [j for j in range(4) if j != k]
        weight = np.sum([np.linalg.inv(made.covariance[j]) for j in others], axis=0)
        own = np.linalg.inv(weight)
        weighted = [np.linalg.solve(made.covariance[j], made.value[j]) for j in others]
        other = own @ np.sum(weighted, axis=0)
        whole = made.covariance[k] + own
        away = made.value[k] - other
        np.testing.assert_allclose(found.z[k], away / np.sqrt(np.diag(whole)))


def test_what_differs_is_named_with_its_file() -> None:
    def of(*away: float) -> tuple[tuple[int, ...], bool]:
        m = len(away)
        value = np.array(away)[:, None] * np.ones(2)
        found = agreement(Basis(("bias_x", "bias_y"), ("", ""), value,
                                np.tile(np.eye(2), (m, 1, 1)), np.full(m, 1e6), ""))  # fmt: skip
        return found.odd, found.answer.told

    assert of(0.0, 0.1, -0.1) == ((), False)
    assert of(0.0, 9.0, 0.1) == ((1,), True)
    assert of(0.0, 9.0) == ((), True)  # either may
    assert of(0.0, 9.0, 0.1, -9.0, 0.2) == ((1, 3), True)


def test_a_scatter_beyond_what_files_state_is_told_as_scatter() -> None:
    """Ten calibrations, four times as far apart as they say, in all that they hold."""
    value = 4.0 * np.random.default_rng(6).standard_normal((6, 4))
    names = ("bias_x", "bias_y", "scale_x", "scale_y")
    found = agreement(Basis(names, ("",) * 4, value, np.tile(np.eye(4), (6, 1, 1)),
                            np.full(6, 1e6), ""))  # fmt: skip
    assert found.answer.of(NOISE) > 0.9


def test_a_limit_is_due_where_the_surest_drift_reaches_it() -> None:
    days = np.array([0.0, 50.0, 100.0])
    value = np.outer(days, [0.02, -0.04, 0.0])
    attitude, variance = np.eye(3), np.array([[1e-6, 1e-6, 4.0]] * 3)
    found = due(days, value, variance, attitude, 3.0)
    assert found.attitude.tolist() == [0.0, 1.0, 0.0]
    assert found.expected == pytest.approx(75.0)
    steepest = slope_of(days, value[:, 2], variance[:, 2], 30)
    assert found.earliest == pytest.approx(3.0 / steepest.half)
    none = due(days, 0.0 * value, variance, attitude, 3.0)
    assert none.expected == np.inf
    assert none.attitude.tolist() == [0.0, 0.0, 1.0]
    several = due(days, value, variance, attitude, 3.0, sensors=4)
    assert several.earliest < found.earliest


def test_an_arrays_places_and_gyros_that_differ_most() -> None:
    """Three boards of four IMUs; the first IMU is where places are counted from."""
    rng = np.random.default_rng(6)
    places, rates = rng.normal(size=(3, 3, 3)), rng.normal(size=(3, 4, 3))
    boards = [
        SimpleNamespace(
            triads=[SimpleNamespace(name=f"imu{k}", gyro_bias=DEG * r[k]) for k in range(4)]
        )
        for r in rates
    ]
    root = 0.1 * rng.normal(size=(3, 9, 9))
    covariance = root @ root.swapaxes(1, 2)
    made = Basis(("p",) * 9, ("mm",) * 9, places.reshape(3, 9), covariance, np.full(3, 9.0), "")
    (place, rate), (said,) = array_meanings(boards, made, {"mm": 0.5, "deg/s": 0.7})  # type: ignore[arg-type]
    away = places[:, None] - places[None]
    far = np.linalg.norm(away, axis=3)
    i, j, k = (int(v) for v in np.unravel_index(np.argmax(far), far.shape))
    assert set(place.pair) == {i, j}
    assert place.value == pytest.approx(far.max())
    assert place.sensor == f"imu{k + 1}"
    assert place.limit == 0.5
    along = away[i, j, k] / far.max()
    own = covariance[[i, j], 3 * k : 3 * k + 3, 3 * k : 3 * k + 3].sum(axis=0)
    assert place.sd == pytest.approx(np.sqrt(along @ own @ along))
    apart = np.abs(rates[:, None] - rates[None])
    i, j, k, axis = (int(v) for v in np.unravel_index(np.argmax(apart), apart.shape))
    assert set(rate.pair) == {i, j}
    assert rate.value == pytest.approx(apart.max())
    assert rate.sensor == f"imu{k}"
    assert f"{apart.max():.2g} deg/s at most (imu{k}, {'xyz'[axis]})" in said
    # Without limits: twice the largest stated sd of a coordinate.
    (place,), _ = array_meanings(boards, made, {})  # type: ignore[arg-type]
    assert place.limit == pytest.approx(2.0 * np.sqrt(np.einsum("kii->ki", covariance).max()))
