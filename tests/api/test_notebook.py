"""In a notebook: a Result is seen, tables and arrays go in, one vector or many come out."""

from __future__ import annotations

import html
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import imucalib
from imucalib.api.result import plots_of
from imucalib.errors import UsageError
from worlds.places import SAMPLES

CAVE = np.loadtxt(SAMPLES / "cave_ai.csv", delimiter=",", skiprows=1)
TABLE = np.loadtxt(SAMPLES / "paper_table_1.csv", delimiter=",", skiprows=3)


class Frame:
    """What imucal asks of a DataFrame: names, and a column by its name."""

    def __init__(self, **columns: Any) -> None:
        self._columns = columns

    @property
    def columns(self) -> list[str]:
        return list(self._columns)

    def __getitem__(self, name: str) -> Any:
        return self._columns[name]


def values(found: imucalib.Result) -> list[float]:
    return [p.value for p in found.calibration.parameters]


@pytest.fixture(scope="module")
def found() -> imucalib.Result:
    return imucalib.lab(SAMPLES / "cave_ai.csv", reference="norm", loop=False)


def test_a_result_is_one_line_and_its_page_one_fold(found: imucalib.Result) -> None:
    assert len(repr(found)) < 200
    assert "lab of cave_ai.csv: ok" in repr(found)
    page = html.unescape(found._repr_html_())
    assert "Good to" in page
    assert "What to do next" in page
    assert "<nav" not in page
    assert len(page) < 40_000


@pytest.mark.parametrize(
    "given",
    [
        CAVE,
        CAVE.tolist(),
        dict(zip("xyz", CAVE.T, strict=True)),
        Frame(x=CAVE[:, 0], y=CAVE[:, 1], z=CAVE[:, 2]),
    ],
    ids=["array", "lists", "columns", "frame"],
)
def test_a_table_of_a_notebook_is_a_file(given: Any, found: imucalib.Result) -> None:
    same = imucalib.lab(given, reference="norm", loop=False)
    np.testing.assert_array_equal(values(same), values(found))


def test_keywords_are_the_commands_options() -> None:
    rows = np.column_stack([TABLE[:, :2], TABLE[:, 2:] * 1e-6 * 16384])
    counts = imucalib.lab(rows, lsb=16384.0, unit="counts", latitude=42.7, exclude=[10], loop=False)
    known = imucalib.lab(rows / [1, 1, 16384, 16384, 16384], unit="g", latitude=42.7, exclude=[10],
                         loop=False)  # fmt: skip
    np.testing.assert_allclose(values(counts), values(known), atol=1e-6)
    assert counts.calibration.gravity == pytest.approx(9.8035, abs=1e-3)
    with pytest.raises(UsageError, match="did you mean unit"):
        imucalib.lab(rows, units="g")  # type: ignore[call-arg]
    with pytest.raises(UsageError, match="exclude each other"):
        imucalib.lab(rows, unit="g", gravity=9.81, latitude=42.7)
    with pytest.raises(UsageError, match="shape"):
        imucalib.lab(np.ones((9, 8)))


def test_a_recording_of_a_notebook_is_read_as_a_file_is() -> None:
    t = np.arange(400) / 100.0
    acc = np.random.default_rng(0).normal((0.0, 0.0, 1.0), 0.01, (400, 3))
    rows = np.column_stack([t, acc])
    one = imucalib.read(rows, unit="g").channels["imu0/acceleration"]
    two = imucalib.read(acc, rate=100.0, unit="g").channels["imu0/acceleration"]
    np.testing.assert_allclose(one.values, 9.80665 * acc)
    np.testing.assert_array_equal(one.values, two.values)
    np.testing.assert_allclose(one.t, two.t, atol=1e-9)


def test_one_vector_or_many(found: imucalib.Result) -> None:
    readings = np.random.default_rng(1).normal(0.0, 5.0, (4, 5, 3))
    many = found.calibration.apply(readings)
    assert many.shape == readings.shape
    one = found.calibration.apply(readings[2, 3].tolist())  # type: ignore[arg-type]
    np.testing.assert_array_equal(one, many[2, 3])
    with pytest.raises(UsageError, match="not x, y, z"):
        found.calibration.apply(np.ones((3, 4)))


class Axes:
    """Remembers what is drawn on it."""

    def __init__(self) -> None:
        self.seen: list[str] = []

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return lambda *_, **__: self.seen.append(name)


def test_figures_are_drawn_where_there_is_matplotlib(
    found: imucalib.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Axes] = []

    def subplots(rows: int, columns: int, **_: Any) -> tuple[str, Any]:
        made.extend(Axes() for _ in range(rows))
        return "figure", np.array(made, dtype=object).reshape(rows, columns)

    library = SimpleNamespace(subplots=subplots)
    monkeypatch.setitem(sys.modules, "matplotlib", SimpleNamespace(pyplot=library))
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", library)
    assert found.plot() == "figure"
    assert all("plot" in ax.seen and "set" in ax.seen for ax in made)
    card = found.document.card
    assert card is not None
    assert plots_of(found.document, "")[0] is card.picture
    with pytest.raises(UsageError, match="there are: Error of"):
        found.plot("absent")
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(UsageError, match="pip install matplotlib"):
        found.plot()
