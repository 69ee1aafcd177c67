"""What rows of a sheet become, and how a bench's errors are judged, by small sheets by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from imucalib.calibrators.lab.bench import (
    implausible_rows,
    in_celsius,
    position_observations,
)
from imucalib.calibrators.lab.errors import attitude_errors
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.core.angle_conventions import Conventions
from imucalib.core.references import KnownVector
from imucalib.errors import UsageError
from imucalib.posterior.held_out import Predictions
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


def errors_of(
    meant: tuple[float, float], read: tuple[float, float], size: float = G
) -> list[float]:
    """Inclination and tool-face (deg) and norm (mg) of one position."""
    one, other = (np.array([[direction(*map(np.array, a))]]) for a in (read, meant))
    found = attitude_errors(
        Predictions(size * one, G * other, size * one - G * other), Conventions()
    )
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
