"""What rows of a sheet become, and how a bench's errors are judged, by small sheets by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.lab.bench import (
    implausible_rows,
    in_celsius,
    position_observations,
    still_observations,
)
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.errors import attitude_errors, noise_floor
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.run import noise_block
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm, KnownVector
from imucalib.errors import UsageError
from imucalib.estimators.least_squares import fit
from imucalib.loop.held_out import Held
from imucalib.loop.posterior.noise import shared_bias
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
