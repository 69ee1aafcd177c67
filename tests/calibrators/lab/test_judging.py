"""How a bench's errors are judged: angles, floors, limits and what is advised, by hand."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from imucalib.calibrators.lab import advice
from imucalib.calibrators.lab.attitude import attitude_errors, rms, worst
from imucalib.calibrators.lab.bench import RawUnit
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.dial import bends
from imucalib.calibrators.lab.errors import noise_floor, reading_noise, setting_noise
from imucalib.calibrators.lab.sessions import between as sessions
from imucalib.calibrators.lab.sessions.between import Between
from imucalib.calibrators.population import not_of_its_kind
from imucalib.core.context import Context
from imucalib.core.observations import Observations, SharedNoise
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.errors import UsageError
from imucalib.loop.held_out import Held
from imucalib.loop.record_errors import RecordError
from imucalib.units import DEG, MG
from worlds.sheets import direction

G = 9.80665


def errors_of(
    meant: tuple[float, float], read: tuple[float, float], size: float = G
) -> list[float]:
    """Inclination and tool-face (deg) and norm (mg) of one position."""
    one, other = (np.array([[direction(*map(np.array, a))]]) for a in (read, meant))
    found = attitude_errors(Held(size * one, G * other, size * one - G * other), Conventions())
    return [float(found.inclination[0]), float(found.tool_face[0]), float(found.norm[0])]


@pytest.mark.parametrize(
    ("meant", "read", "inclination", "tool_face"),
    [
        ((10.0, 20.0), (10.5, 20.0), 0.5, 0.0),
        ((10.0, 20.0), (10.0, 19.0), 0.0, -1.0),
        ((0.0, 0.5), (0.0, 359.5), 0.0, -1.0),  # across the turn
        ((0.0, 359.5), (0.0, 0.5), 0.0, 1.0),
        ((85.0, 30.0), (91.0, 30.0), 6.0, 0.0),  # 91 is not read as 89 of the other side
        ((-85.0, 30.0), (-92.0, 31.0), -7.0, 1.0),
        ((40.0, 10.0), (40.0, 110.0), 0.0, 100.0),  # a flat tool is turned, not folded
        ((-60.0, 200.0), (-59.0, 198.0), 1.0, -2.0),
    ],
)
def test_angles_are_compared_on_vectors(
    meant: tuple[float, float], read: tuple[float, float], inclination: float, tool_face: float
) -> None:
    assert errors_of(meant, read) == pytest.approx([inclination, tool_face, 0.0], abs=1e-9)


def test_the_size_is_compared_with_gravity() -> None:
    assert errors_of((10.0, 20.0), (10.0, 20.0), 1.003 * G)[2] == pytest.approx(3.0)


def test_the_size_is_compared_with_what_a_swing_of_the_bench_makes_of_gravity() -> None:
    one = G * direction(np.array(10.0), np.array(20.0))[None, None]
    found = attitude_errors(Held(1.004 * one, 1.003 * one, 0.001 * one), Conventions())
    assert found.norm[0] == pytest.approx(1.0)


def test_tool_face_means_nothing_within_three_degrees_of_the_vertical() -> None:
    assert np.isnan(errors_of((87.2, 0.0), (87.2, 5.0))[1])
    assert errors_of((87.1, 0.0), (87.1, 5.0))[1] == pytest.approx(5.0)
    assert np.isnan(errors_of((-88.0, 0.0), (-88.0, 5.0))[1])


def test_what_has_no_value_counts_in_no_mean() -> None:
    assert worst(np.array([1.0, -3.0, np.nan])) == 3.0
    assert rms(np.array([1.0, -7.0, np.nan])) == 5.0
    assert worst(np.array([np.nan])) == rms(np.array([])) == 0.0


def repeated(pairs: int, apart: float) -> Observations:
    """Attitudes that are taken twice, in mixed order, whose readings differ by 1, 2 and 2 times
    `apart`; and as many that are taken once."""
    place = np.array([*range(pairs), *range(pairs), *range(pairs, 2 * pairs)])
    i, t = 3.0 * place - 40.0, 11.0 * place
    reading = G * direction(i, t)
    reading[pairs : 2 * pairs] += apart * np.array([1.0, 2.0, 2.0])
    ids = np.arange(len(place))
    reference = KnownVector(np.radians(i), np.radians(t), G, ids, ids)
    names = tuple(map(str, ids))
    return Observations(reading[:, None], np.ones((len(ids), 1, 3)), reference, Context(len(ids)),
                        ids, names)  # fmt: skip


def test_the_floor_is_that_of_six_repeats_or_more() -> None:
    """Differences of two readings scatter by √2; 1.4826 makes a median a standard deviation."""
    assert noise_floor(repeated(6, 1e-2), None) == pytest.approx(1.4826 * 3e-2 / np.sqrt(2.0))
    assert np.isnan(noise_floor(repeated(5, 1e-2), None))
    assert noise_floor(repeated(5, 1e-2), 1e-3) == pytest.approx(3**0.5 * 1e-3)
    norm = Observations(np.ones((3, 1, 3)), np.ones((3, 1, 3)), KnownNorm(3, G), Context(3),
                        np.arange(3), ("",) * 3)  # fmt: skip
    assert noise_floor(norm, 1e-3) == pytest.approx(1e-3)
    assert np.isnan(noise_floor(norm, None))


def told(floor_deg: float, sensor_mg: float = 1.0, factor: float = 1.0) -> list[str]:
    """Sentences on whose the scatter of tool-face is."""
    ids = np.arange(2)
    reference = KnownVector(np.zeros(2), np.zeros(2), G, ids, ids)
    noise = SimpleNamespace(factor=factor, sd=(9.0, floor_deg * DEG),
                            component=("inclination setting", "tool-face setting"))  # fmt: skip
    at = SimpleNamespace(sigma=np.full((2, 3), sensor_mg * MG), free=2)
    of = SimpleNamespace(reference=reference, walk=None, shared=())
    fit = SimpleNamespace(noise=noise, at=at, observations=of)
    assert setting_noise(fit)["tool-face setting"] == pytest.approx(floor_deg * DEG)
    fit.noise_sd = np.array([0.1, 0.2, 0.3])
    alone = reading_noise(fit)
    own = factor * sensor_mg * MG
    assert (alone.own, alone.own_sd) == pytest.approx((own, 0.1 * own))
    assert (alone.shared, alone.memory, alone.whole) == (0.0, 0.0, alone.own)
    of.walk = SharedNoise("walk", np.eye(2), 7.0)
    beside = reading_noise(fit)
    assert (beside.shared, beside.memory) == (floor_deg * DEG, 7.0)
    assert beside.shared_sd == pytest.approx(0.3 * floor_deg * DEG)
    of.walk = None
    return advice._settings(fit)


def test_the_hand_scatters_where_the_sensor_does_not() -> None:
    """1 mg of noise is 0.0573 deg of a level tool: told from twice that on, up to what a bench can
    be."""
    assert not told(0.114)
    (sentence,) = told(0.116)
    assert "by 0.12 deg because the table is set by hand" in sentence
    assert "(0.06 deg / cos(inclination))" in sentence
    assert told(2.99)
    assert not told(3.01)
    assert not told(0.116, factor=1.1)
    assert not told(0.116, sensor_mg=1.1)


def test_a_device_far_from_its_fleet_is_told_from_one_in_a_hundred_on() -> None:
    def of(strange: float) -> tuple[str, ...]:
        return not_of_its_kind(strange, "instead")

    assert not of(0.0101)
    assert not of(float("nan"))
    assert "with a chance of 0.009;" in of(0.009)[0]
    assert "1e-12" in of(0.0)[0]


def test_a_record_is_repaired_in_the_tables_unit() -> None:
    raw = RawUnit("mg", MG, "")
    record = RecordError(
        row=3, where="row 4", channel="x", size=1.0, sd=0.1, unit="mg", likely="sign",
        fix=(("x", 0.5 * G),), p=0.0, evidence=9.0,
    )  # fmt: skip
    assert advice.fix_option(record, raw) == "--fix 4:x=500 or --exclude 4 (or --auto-exclude)"


def split(name: str, corrected: list[float]) -> SimpleNamespace:
    """A held-out part of a level tool that reads some errors along and across, mg."""
    meant = G * np.array([[[0.0, 1.0, 0.0]]] * len(corrected))
    error = MG * np.array(corrected)[:, None, None] * np.array([0.0, 0.6, 0.8])
    return SimpleNamespace(name=name, final=Held(meant + error, meant, error))


def limited(**asked: float) -> tuple[object, ...]:
    ids = np.arange(2)
    reference = KnownVector(np.zeros(2), np.zeros(2), G, ids, ids)
    result = SimpleNamespace(
        splits=(split("leave one out", [9.0, 9.0]), split("held out", [3.0, -4.0])),
        observations=SimpleNamespace(reference=reference),
        settings=SimpleNamespace(conventions=Conventions()),
    )
    names = {k.replace("_", "-"): v for k, v in asked.items()}
    return advice.limits_of(result, names)  # type: ignore[arg-type, return-value]


def test_limits_hold_what_took_no_part_in_the_choice() -> None:
    """The last split: the strictest that there is."""
    every = limited(max_error=1.0, max_inclination_error=1.0, max_toolface_error=1.0,
                    max_norm_error=1.0)  # fmt: skip
    error, inclination, tool_face, norm = (one.value for one in every)  # type: ignore[attr-defined]
    assert error == pytest.approx(np.sqrt(12.5))
    assert inclination == pytest.approx(4e-3 * 0.8 / DEG, rel=0.01)
    assert tool_face == 0.0
    assert norm == pytest.approx(0.6 * np.sqrt(12.5), rel=0.01)
    assert every[0].name == "max-error, held out"  # type: ignore[attr-defined]
    assert limited() == ()


def test_limits_need_something_held_out() -> None:
    nothing = SimpleNamespace(splits=())
    assert advice.limits_of(nothing, {}) == ()  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="held-out"):
        advice.limits_of(nothing, {"max-error": 1.0})  # type: ignore[arg-type]


def test_only_what_turns_inclination_bends_the_dial() -> None:
    def of(*names: str) -> bool:
        return bends(SimpleNamespace(model=SimpleNamespace(names=names)))  # type: ignore[arg-type]

    assert of("bias", "inclination_zero")
    assert not of("bias", "tool_face_zero")


def between(sizes: np.ndarray, weights: np.ndarray, sd: float = 1.0) -> Between:
    return Between(
        name="session bias", effect="bias", unit="mg", sd=sd, sizes=sizes, weights=weights,
        by_axis=np.tile(weights, (3, 1)), offsets=np.zeros((5, 3)), offsets_sd=np.ones((5, 3)),
    )  # fmt: skip


def test_the_interval_of_a_scatter_holds_the_middle_95_percent() -> None:
    """Of a normal density on a grid: ±1.96 deviations."""
    sizes = np.linspace(0.0, 20.0, 2001)
    weights = stats.norm.pdf(sizes, 10.0, 2.0)
    low, high = between(sizes, weights / weights.sum()).interval
    assert (low, high) == pytest.approx((10.0 - 3.92, 10.0 + 3.92), abs=0.02)


def test_the_next_power_up_scatters_by_the_mean_and_by_what_sessions_do() -> None:
    """Of one known size s: variance of the mean and s²; of two, a mixture's quantile."""
    parameter = SimpleNamespace(name="bias_x", unit="mg")
    fit = SimpleNamespace(parameters=(parameter,), covariance=np.array([[0.25]]),
                          theta=np.array([7.0]))  # fmt: skip
    one = sessions._next(fit, 0, between(np.array([2.0]), np.ones(1), sd=2.0), np.ones(1))  # type: ignore[arg-type]
    assert (one.value, one.mean, one.sd) == pytest.approx((7.0, 0.5, np.sqrt(4.25)))
    assert one.half == pytest.approx(1.959964 * np.sqrt(4.25))
    # A larger scatter leaves the mean more open: by its share over the five sessions.
    sizes, weights = np.array([1.0, 3.0]), np.array([0.4, 0.6])
    two = sessions._next(fit, 0, between(sizes, weights, sd=2.0), weights)  # type: ignore[arg-type]
    var = np.maximum(0.25 + (sizes**2 - 4.0) / 5.0, 0.025) + sizes**2
    assert two.sd == pytest.approx(np.sqrt(weights @ var))
    inside = 2.0 * stats.norm.cdf(two.half / np.sqrt(var)) - 1.0
    assert weights @ inside == pytest.approx(0.95)
