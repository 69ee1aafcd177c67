"""The Python API: its page runs, results are those of the commands, a notebook's tables go in."""

from __future__ import annotations

import html
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import imucalib
from imucalib.api.result import plots_of
from imucalib.errors import UnreadableInput, UsageError
from worlds.places import ROOT, SAMPLES


@pytest.fixture(scope="module")
def found() -> imucalib.Result:
    return imucalib.lab(SAMPLES / "cave_ai.csv", reference="norm", loop=False)


def test_the_page_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sample_logs").symlink_to(SAMPLES)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
    world: dict[str, object] = {}
    for block in re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE):
        exec(compile(block, "python.md", "exec"), world)
    first = world["found"]
    assert isinstance(first, imucalib.Result)
    assert first.effects
    assert first.gain is not None
    assert first.gain.after < first.gain.before
    assert {p.name for p in (tmp_path / "out").iterdir()} == {
        "calibration.yaml", "report.html", "report.json"
    }  # fmt: skip


def test_a_loaded_calibration_corrects_as_the_run_does(
    found: imucalib.Result, tmp_path: Path
) -> None:
    found.save(tmp_path)
    reading = np.random.default_rng(0).normal(0.0, 5.0, (20, 3))
    loaded = imucalib.load(tmp_path / "calibration.yaml")
    made = (one.apply(reading, unit="m/s2") for one in (loaded, found.calibration))
    np.testing.assert_array_equal(*made)


def test_keywords_replace_the_requests_fields() -> None:
    from imucalib.calibrators.lab.request import LabRequest

    request = LabRequest(reference="norm", gravity=9.7, seed=3)
    run = imucalib.lab(SAMPLES / "cave_ai.csv", request=request, gravity=9.81, loop=False).run
    assert run.calibration.gravity == 9.81
    assert run.outcome.provenance.seed == 3
    assert run.outcome.findings is None


def test_tables_are_made_by_whatever_is_installed(
    found: imucalib.Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    for absent in ("pandas", "polars"):
        monkeypatch.setitem(sys.modules, absent, None)
    with pytest.raises(UsageError, match="no library"):
        found.to_dataframe()
    monkeypatch.setitem(sys.modules, "polars", SimpleNamespace(DataFrame=list))
    assert {"name", "value", "sd", "unit"} <= set(found.to_dataframe()[0])
    (error,) = found.to_dataframe("errors")
    assert error["held_out_final"] == found.report["loop"]["errors"][0]["held_out"]["final"]
    assert found.to_dataframe("candidates") == []
    with pytest.raises(UsageError, match="no table"):
        found.to_dataframe("others")  # type: ignore[arg-type]


def test_failures_are_the_programs_own(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput) as caught:
        imucalib.read(tmp_path / "absent.csv")
    assert caught.value.exit_code == 3
    with pytest.raises(AttributeError, match="no attribute 'absent'"):
        imucalib.absent  # noqa: B018


def test_nothing_is_imported_before_it_is_asked_for() -> None:
    code = "import sys, imucalib; dir(imucalib); print('numpy' in sys.modules); imucalib.lab"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


CAVE = np.loadtxt(SAMPLES / "cave_ai.csv", delimiter=",", skiprows=1)
TABLE = np.loadtxt(SAMPLES / "paper_table_1.csv", delimiter=",", skiprows=3)


class Frame:
    """What imucal asks of a DataFrame: names, and a column by its name."""

    def __init__(self, **columns: Any) -> None:
        self.columns, self._columns = list(columns), columns

    def __getitem__(self, name: str) -> Any:
        return self._columns[name]


def values(found: imucalib.Result) -> list[float]:
    return [p.value for p in found.calibration.parameters]


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
    many = found.calibration.apply(readings, unit="m/s2")
    assert many.shape == readings.shape
    one = found.calibration.apply(readings[2, 3].tolist(), unit="m/s2")  # type: ignore[arg-type]
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


@pytest.mark.parametrize(("unit", "size"), [("g", 1.0), ("mg", 1000.0), ("m/s2", 9.80665)])
def test_readings_are_taken_in_the_unit_that_was_calibrated(unit: str, size: float) -> None:
    turns = np.random.default_rng(1).normal(size=(14, 3))
    up = turns / np.linalg.norm(turns, axis=1)[:, None]
    raw = size * (up * [1.02, 0.97, 1.01] + [0.03, -0.02, 0.01])
    found = imucalib.lab(raw, unit=unit, reference="norm", loop=False)
    assert found.calibration.sensor is not None
    assert found.calibration.sensor.unit == unit
    norms = np.linalg.norm(found.calibration.apply(raw), axis=1)
    np.testing.assert_allclose(norms, size, rtol=1e-3)
    in_si = found.calibration.apply(raw * 9.80665 / size, unit="m/s2")
    np.testing.assert_allclose(np.linalg.norm(in_si, axis=1), 9.80665, rtol=1e-3)
