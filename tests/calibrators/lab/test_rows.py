"""What the rows of a sheet become: settings, noise, sweeps and covariates, by small sheets that are
worked out by hand."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest

from imucalib.calibrators.lab import faults
from imucalib.calibrators.lab.bench import (
    position_observations,
    row_numbers,
    still_observations,
)
from imucalib.calibrators.lab.checks import (
    refuse_sizes,
    refuse_temperatures,
    without_temperature,
)
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.faults import sheet_of
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.core.references import KnownVector
from imucalib.errors import UsageError
from imucalib.units import DEG, MG

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
    return sheet_of(made, whole, np.array(rows), Conventions(), G)


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
        refuse_sizes(made, np.array([1]), np.arange(8))
    assert words in caught.value.what
    assert caught.value.where.endswith("row 2")
    assert caught.value.remedy == f"{fix}--exclude 2 or --auto-exclude"
    assert "(so are 1 more)" in _told(made)
    refuse_sizes(made, np.array([], np.intp), np.arange(8))


def _told(made: PositionTable) -> str:
    with pytest.raises(UsageError) as caught:
        refuse_sizes(made, np.array([1, 2]), np.arange(8))
    return caught.value.what


@pytest.mark.parametrize("code", [85.0, -127.0])
def test_what_a_thermometer_says_that_has_not_measured_is_no_temperature(code: float) -> None:
    def bad(*values: float, **unit: str) -> list[int]:
        made = table(unit or {"temperature": "C"}, temperature=values)
        return list(without_temperature(made, np.arange(len(values))))

    assert bad(20.0, code, 22.0, 23.0, code) == [1, 4]
    assert bad(20.0, 21.0, code + 0.1, 22.0) == []
    assert bad(code, 20.0, code, 20.0) == []  # as often as not: two temperatures
    assert bad(20.0, 21.0, 22.0, 23.0, 24.0, code, code) == []  # an oven stands there
    assert bad(20.0, code, code + 29.0, 23.0, 20.0) == []
    assert bad(250.0, code, 260.0, 255.0, temperature="K") == []
    made = table({"temperature": "C"}, temperature=[20.0, code, 22.0])
    refuse_temperatures(made, np.array([], np.intp))
    with pytest.raises(UsageError, match="not measured") as caught:
        refuse_temperatures(made, np.array([1]))
    assert caught.value.where.endswith("row 2, column temperature")
    assert "--exclude 2" in caught.value.remedy
    assert without_temperature(table(x=[1, 2]), np.arange(2)).size == 0


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
