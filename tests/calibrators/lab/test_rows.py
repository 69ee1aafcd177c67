"""What rows of a sheet become, and how a bench's errors are judged, by small sheets by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab import advice, dial, faults
from imucalib.calibrators.lab.bench import (
    implausible_rows,
    in_celsius,
    position_observations,
    row_numbers,
    still_observations,
)
from imucalib.calibrators.lab.calibration import noise_block
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.dial import Dial, dial_of
from imucalib.calibrators.lab.errors import attitude_errors, noise_floor
from imucalib.calibrators.lab.faults import sheet_of
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.errors import UsageError
from imucalib.estimators.least_squares import fit
from imucalib.loop.held_out import Held
from imucalib.loop.posterior.noise import shared_bias
from imucalib.units import DEG, MG
from worlds.bench import base_model, bench, draw, ordinary_theta
from worlds.sheets import direction

G = 9.80665


def table(unit: dict[str, str] | None = None, **columns: Sequence[float]) -> PositionTable:
    values = {name: np.array(v, float) for name, v in columns.items()}
    n = len(next(iter(values.values())))
    for axis in "xyz":
        values.setdefault(axis, np.arange(1.0, n + 1) * (1 + "xyz".index(axis)))
    return PositionTable(values, {k: k for k in values}, unit or {}, np.arange(1, n + 1), "s", "")


def ids(sheet: PositionTable) -> tuple[list[int], list[int]]:
    reference = position_observations(sheet, sheet.raw(), Conventions(), G).reference
    assert isinstance(reference, KnownVector)
    return list(reference.inclination_setting), list(reference.tool_face_setting)


def test_a_dial_is_set_anew_where_its_value_or_its_power_up_changes() -> None:
    angles = {"inclination": [0, 0, 5, 5, 0], "tool_face": [10, 20, 20, 20, 20]}
    assert ids(table(**angles)) == ([0, 0, 1, 1, 2], [0, 1, 1, 1, 1])
    apart = table(**angles, session=[0, 0, 0, 1, 1])
    assert ids(apart) == ([0, 0, 1, 2, 3], [0, 1, 1, 2, 2])
    named = table(**angles, inclination_setting=[7, 7, 9, 9, 7], session=[0, 0, 0, 1, 1])
    assert ids(named)[0] == [0, 0, 1, 1, 0]


def test_noise_falls_with_the_root_of_the_samples() -> None:
    """About a row of median count."""
    sheet = table(inclination=[0, 1, 2], tool_face=[0, 0, 0], samples=[4, 16, 64])
    data = position_observations(sheet, sheet.raw(), Conventions(), G, sigma=3.0)
    assert data.sigma.shape == (3, 1, 3)
    assert data.sigma[:, 0, 1].tolist() == [6.0, 3.0, 1.5]
    never = table(inclination=[0, 1], tool_face=[0, 0], samples=[0, 1])
    assert (
        still_observations(never, never.raw(), G, sigma=2.0).sigma[:, 0, 0].tolist()
        == [pytest.approx(2.0 * 0.5**0.5)] * 2
    )
    alike = table(inclination=[0, 1], tool_face=[0, 0])
    assert (still_observations(alike, alike.raw(), G).sigma == MG).all()


def test_covariates_are_what_stood_before_and_when() -> None:
    sheet = table(inclination=[0, 30], tool_face=[90, 90], temperature=[20, 25], time=[0, 60])
    data = position_observations(sheet, sheet.raw(), Conventions(), G)
    found = data.context.covariates
    assert found["previous_y"].tolist() == [2.0, 2.0]
    assert found["previous_z"].tolist() == [3.0, 3.0]
    assert found["record"].tolist() == [0.0, 1.0]
    assert found["order"].tolist() == [0.0, 1.0]
    assert found["temperature"].tolist() == [20.0, 25.0]
    assert found["time"].tolist() == [0.0, 60.0]
    assert found["inclination"].tolist() == pytest.approx([0.0, 30.0 * DEG])
    assert found["tool_face"].tolist() == pytest.approx([90.0 * DEG] * 2)
    assert data.label == ("row 1", "row 2")
    assert row_numbers(data).tolist() == [1, 2]
    long = table(inclination=[0, 1, 2], tool_face=[0, 0, 0])
    before = still_observations(long, long.raw(), G).context.covariates
    assert before["previous_x"].tolist() == [1.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("inclination", "tool_face", "sweeps"),
    [
        # A meridian, then a ring: its first row holds neither dial of the row before.
        ([0, 10, 20, 30, 50, 50, 50, 50], [0, 0, 0, 0, 60, 120, 180, 240], [0] * 4 + [1] * 4),
        # The corner belongs to both: a new sweep starts where the old one's dial is left.
        ([0, 10, 20, 20, 20, 20, 20, 20], [0, 0, 0, 60, 120, 180, 240, 300], [0] * 3 + [1] * 5),
        # Neither held for four rows on average: no sweeps.
        ([0, 10, 20, 30, 40, 50, 60, 70], [0, 40, 80, 120, 160, 200, 240, 280], [0] * 8),
        # Nine rows carry two sweeps, seven do not.
        ([0, 1, 2, 3, 50, 50, 50], [0, 0, 0, 0, 6, 12, 18], [0] * 7),
    ],
)
def test_a_sweep_is_a_run_that_holds_one_dial(
    inclination: list[float], tool_face: list[float], sweeps: list[int]
) -> None:
    sheet = table(inclination=inclination, tool_face=tool_face)
    context = position_observations(sheet, sheet.raw(), Conventions(), G).context
    assert context.covariates["sweep"].tolist() == sweeps
    assert context.sweeps == max(sweeps) + 1


def sheet(made: PositionTable, rows: Sequence[int], **unit: str) -> faults.Sheet:
    """As the search for slips sees some rows: readings in m/s², the table's first rows noisier."""
    whole = still_observations(made, made.raw() * MG, G)
    return sheet_of(made, whole, np.array(rows), LabRequest(gravity=G))


def mixed(**more: Sequence[float]) -> PositionTable:
    """24 rows in no order of work; two neighbours of one inclination."""
    rng = np.random.default_rng(5)
    i, t = rng.permutation(24) * 5.0 - 60.0, rng.permutation(24) * 15.0
    i[4] = i[3]
    return table(inclination=i, tool_face=t, **more)


def test_neighbours_share_a_setting_only_in_an_order_of_work() -> None:
    """By the way from row to row, or by a time that grows; else each row was set by itself, unless
    the sheet says what was set."""
    every = list(range(24))
    loose = sheet(mixed(), every)
    assert not loose.ordered
    assert loose.inclination_setting.tolist() == every
    timed = sheet(mixed(time=np.arange(24.0)), every)
    assert timed.ordered
    held = [k - (k > 3) for k in every]
    assert timed.inclination_setting.tolist() == held
    assert timed.tool_face_setting.tolist() == every
    stands = np.maximum(np.arange(24.0), 1.0)  # a clock that stands still once
    assert not sheet(mixed(time=stands), every).ordered
    said = sheet(mixed(inclination_setting=np.arange(24.0) // 2), every)
    assert said.inclination_setting.tolist() == [k // 2 for k in every]
    assert said.tool_face_setting.tolist() == every
    k = np.arange(24)
    worked = table(inclination=40.0 * (k // 8), tool_face=45.0 * (k % 8))
    assert sheet(worked, every).inclination_setting.tolist() == (k // 8).tolist()


@pytest.mark.parametrize(
    ("reading", "words", "fix"),
    [
        ([30.0, 8000.0, 599.0], "8 times", "y may be ten times too large: --fix 2:y=800, "),
        ([30.0, 80.0, 600.0], "0.61 times", "y may be ten times too small: --fix 2:y=800, "),
        ([30.0, 95.0, 20.0], "0.1 times", "y may be ten times too small: --fix 2:y=950, "),
        (
            [-75.0, 76.0, 640.0],
            "0.65 times",
            "y may be ten times too small: --fix 2:y=760, "
            "or x may be ten times too small: --fix 2:x=-750, ",
        ),
        ([2000.0, 2000.0, 2000.0], "3.5 times", ""),
    ],
)
def test_the_slip_of_ten_that_explains_a_size(reading: list[float], words: str, fix: str) -> None:
    rows = np.array([[0.0, 0.0, 1000.0], reading] + [[0.0, 1000.0, 0.0]] * 6)
    made = table(x=rows[:, 0].tolist(), y=rows[:, 1].tolist(), z=rows[:, 2].tolist())
    with pytest.raises(UsageError) as caught:
        implausible_rows(made, np.arange(8), refuse=True)
    assert words in caught.value.what
    assert caught.value.where.endswith("row 2")
    assert caught.value.remedy == f"{fix}--exclude 2 or --auto-exclude"
    assert implausible_rows(made, np.arange(8), refuse=False) == {1: "size of |a|"}


@pytest.mark.parametrize("code", [85.0, -127.0])
def test_what_a_thermometer_says_that_has_not_measured_is_no_temperature(code: float) -> None:
    def bad(*values: float, **unit: str) -> list[int]:
        plain = {axis: [1.0] * len(values) for axis in "xyz"}
        made = in_celsius(table(unit or {"temperature": "degC"}, temperature=values, **plain))
        return list(implausible_rows(made, np.arange(len(values)), refuse=False))

    assert bad(20.0, code, 22.0, 23.0, code) == [1, 4]
    assert bad(20.0, 21.0, code + 0.1, 22.0) == []
    assert bad(code, 20.0, code, 20.0) == []  # as often as not: two temperatures
    assert bad(20.0, 21.0, 22.0, 23.0, 24.0, code, code) == []  # an oven stands there
    assert bad(20.0, code, code + 29.0, 23.0, 20.0) == []
    assert bad(250.0, code, 260.0, 255.0, temperature="K") == []
    plain = {axis: [1.0] * 3 for axis in "xyz"}
    made = table({"temperature": "degC"}, temperature=[20.0, code, 22.0], **plain)
    with pytest.raises(UsageError, match="not measured") as caught:
        implausible_rows(made, np.arange(3), refuse=True)
    assert caught.value.where.endswith("row 2, column temperature")
    assert "--exclude 2" in caught.value.remedy


def held(raw: float, final: float) -> SimpleNamespace:
    return SimpleNamespace(error=SimpleNamespace(held_out=SimpleNamespace(raw=raw, final=final)))


def test_a_calibration_is_worth_its_name_below_nine_tenths_of_the_raw_error() -> None:
    rng = np.random.default_rng(0)
    whole = SimpleNamespace(reading=rng.normal(0.0, G, (20, 1, 3)))
    assert not faults.worthless(held(10.0, 8.9), whole)
    assert not faults.worthless(held(10.0, np.nan), whole)
    (reason,) = faults.worthless(held(10.0, 9.1), whole)
    assert "9.1 mg is not clearly below the raw reading's 10 mg" in reason
    coarse = SimpleNamespace(reading=5.0 * MG * np.round(whole.reading / (5.0 * MG)))
    (reason,) = faults.worthless(held(10.0, 1.0), coarse)
    assert "steps of 5 mg" in reason


def late(warm: Sequence[float], share: float) -> list[float]:
    found = [warm[0]]
    for value in warm[1:]:
        found.append(found[-1] + share * (value - found[-1]))
    return found


def test_a_sensor_may_trail_its_thermometer_by_rows_or_by_the_clock() -> None:
    warm = [20.0, 30.0, 30.0, 10.0, 10.0, 10.0, 25.0, 25.0]
    sheet = table(temperature=warm)
    found = still_observations(sheet, sheet.raw(), G).context
    share = 1.0 - np.exp(-0.5)
    np.testing.assert_allclose(found["temperature_lag_2rows"], late(warm, share))
    assert "temperature_lag_4rows" not in found  # four lags do not pass in eight rows
    timed = table({"time": "s"}, temperature=warm, time=36.0 * np.arange(8))
    found = still_observations(timed, timed.raw(), G).context
    np.testing.assert_allclose(found["temperature_lag_0.02h"], late(warm, share))
    # Every power-up begins as warm as its thermometer.
    twice = table(temperature=2 * warm, session=[0] * 8 + [1] * 8)
    found = still_observations(twice, twice.raw(), G).context
    np.testing.assert_allclose(found["temperature_lag_2rows"], 2 * late(warm, share))
    for without in (table(samples=[1] * 8), table(temperature=[20.0] * 8)):
        known = still_observations(without, without.raw(), G).context.covariates
        assert not [name for name in known if "lag" in name]


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


def test_the_size_is_compared_with_what_a_swing_of_the_bench_makes_of_gravity() -> None:
    one = G * direction(np.array(10.0), np.array(20.0))[None, None]
    found = attitude_errors(Held(1.004 * one, 1.003 * one, 0.001 * one), Conventions())
    assert found.norm[0] == pytest.approx(1.0)


def test_tool_face_means_nothing_within_three_degrees_of_the_vertical() -> None:
    assert np.isnan(errors_of((87.2, 0.0), (87.2, 5.0))[1])
    assert errors_of((87.1, 0.0), (87.1, 5.0))[1] == pytest.approx(5.0)
    assert np.isnan(errors_of((-88.0, 0.0), (-88.0, 5.0))[1])


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
        request=LabRequest(),
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


def test_rivals_share_the_dial_by_their_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mixture's mean, and its variance by that within and between (the law of total
    variance)."""
    others = {
        "a": Dial(np.array([1.2, 1.0]), np.array([0.5, 0.2]), np.array([1.0, 0.5])),
        "b": Dial(np.array([0.2, 3.0]), np.array([0.1, 0.6]), np.array([0.3, 1.2])),
        "c": Dial(np.array([1.5, 2.5]), np.array([0.3, 0.5]), np.array([0.6, 1.1])),
    }
    monkeypatch.setattr(dial, "dial_of_fit", lambda fit, *at: others[fit])
    weights = {"a": 0.5, "b": 0.3, "c": 0.2}
    group = tuple(SimpleNamespace(weight=w, fit=name) for name, w in weights.items())
    loop = SimpleNamespace(weighed=group)
    result = SimpleNamespace(final="a", loop=loop, request=LabRequest())
    found = dial_of(result, np.zeros(2))  # type: ignore[arg-type]
    mean = sum(w * others[n].shift for n, w in weights.items())
    between = sum(w * others[n].shift ** 2 for n, w in weights.items()) - mean**2
    within = sum(w * others[n].sd ** 2 for n, w in weights.items())
    wide = sum(w * others[n].half ** 2 for n, w in weights.items())
    np.testing.assert_allclose(found.shift, mean)
    np.testing.assert_allclose(found.sd, np.sqrt(within + between))
    np.testing.assert_allclose(found.half, np.sqrt(wide + 1.96**2 * between))


def test_noise_that_rows_share_is_in_mg() -> None:
    """An AR(1) noise of 30 mm/s² beside 0.3 mg: 3.06 mg, within its own standard deviation."""
    base, data = base_model(), bench(5, 60)
    rng, walk = np.random.default_rng(3), np.zeros((60, 3))
    for k in range(1, 60):
        walk[k] = 0.6 * walk[k - 1] + 0.024 * rng.standard_normal(3)
    made = draw(base, ordinary_theta(base, data, 5), data, 6)
    memory = -1.0 / np.log(0.6)
    shared = (shared_bias(data, memory),)
    found = fit(base, replace(made.with_reading(made.reading + walk[:, None]), shared=shared))
    block = noise_block(found)
    assert block["shared_mg"] == pytest.approx(30.0 / 9.80665, abs=4.0 * block["shared_sd_mg"])
    assert 0.05 < block["shared_sd_mg"] < 1.0
    assert block["shared_memory_positions"] == pytest.approx(memory)
