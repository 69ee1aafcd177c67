"""The Python API: the page about it runs, results are those of the commands, imports are lazy."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import imucalib
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
    np.testing.assert_array_equal(loaded.apply(reading), found.calibration.apply(reading))


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
