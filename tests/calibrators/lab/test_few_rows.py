"""Stated intervals hold with few rows too: sheets of a generator that imports nothing fitted."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from imucalib.calibration.file import check
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from worlds.places import ROOT


def _generator() -> ModuleType:
    path = ROOT / "benchmarks" / "lab" / "few_rows.py"
    spec = importlib.util.spec_from_file_location("few_rows", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


SHEETS = _generator()


@pytest.mark.parametrize("kind", ["6 rows", "9 rows", "12 rows", "six faces", "twice"])
def test_corrected_vectors_lie_within_what_is_stated(kind: str) -> None:
    """Of 95 % intervals of 12 sheets at least 88 % hold: below that by chance once in 100, were it
    95 % and the directions of a sheet one number; before, 6 rows held 74.9 to 81.5 %."""
    held, z = [], []
    for seed in range(12):
        holds, score, *_ = SHEETS.judged(kind, seed, loop=False, usual=(1.0, 0.3))
        held.append(holds.mean())
        z.append(np.mean(score**2))
    assert np.mean(held) > 0.88
    assert np.sqrt(np.mean(z)) < 1.35


def test_six_rows_state_no_certainty() -> None:
    """Every interval is wider than the noise that such a sheet has at least."""
    for seed in range(6):
        rng = np.random.default_rng(seed)
        table, reference, *_ = SHEETS.sheet("6 rows", rng, (1.0, 0.3))
        request = LabRequest(
            reference=reference, gravity=SHEETS.G, settings=LabSettings(loop=False)
        )
        run = run_lab(table, request)
        bias = [p.sd for p in run.calibration.parameters if p.name.startswith("bias")]
        assert min(bias) > 0.1
        assert run.outcome.advice[0].startswith("Take every position twice")


def test_six_faces_are_as_good_as_the_size_of_gravity() -> None:
    """Bias from six faces that are set badly: the tilt of a face is no error of its own axis."""
    off, stated = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        table, reference, _, bias = SHEETS.sheet("six faces", rng, (1.0, 0.3))
        request = LabRequest(
            reference=reference, gravity=SHEETS.G, settings=LabSettings(loop=False)
        )
        run = run_lab(table, request)
        found = {p.name: p for p in run.calibration.parameters}
        for k, axis in enumerate("xyz"):
            off.append(found[f"bias_{axis}"].value - bias[k] / SHEETS.MG)
            stated.append(found[f"bias_{axis}"].sd)
        assert run.outcome.advice[0].startswith("Take every face twice")
        check(run.calibration, "of six faces")
    assert np.median(np.abs(off)) < 1.0
    assert np.sqrt(np.mean((np.array(off) / stated) ** 2)) < 1.3


def test_an_interval_wider_than_a_circle_is_no_number() -> None:
    """Paper 004's own objective leaves a combination open: that is said, not 867 deg."""
    from imucalib.calibrators.lab.position_table import read_position_table
    from imucalib.calibrators.lab.request import as_published
    from imucalib.report.lab import lab_document
    from worlds.places import SAMPLES

    table = read_position_table(SAMPLES / "paper_table_1.csv")
    run = run_lab(table, as_published(LabRequest(fixes=((10, "y", -58593.0),))))
    card = lab_document(run).card
    assert card is not None
    angles = [w.value for w in card.good_to if "one reading" in w.detail]
    assert angles == ["not determined", "not determined"]
