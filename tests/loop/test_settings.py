"""Few settings of a dial that is off look like badly set ones: told, and no effect is claimed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.bench import raw_unit
from imucalib.calibrators.lab.calibrate import LabSettings
from imucalib.calibrators.lab.checks import observations_of
from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.effects import named
from imucalib.estimators.least_squares import fit
from imucalib.loop.noise.settings import doubtful_dials
from imucalib.loop.thresholds import NOISE_ALPHA

BASE = Model(tuple(named(n) for n in ("mounting", "bias", "scale", "non_orthogonality")))


def swept(path: Path, off: np.ndarray, scatter: float = 0.05, seed: int = 0) -> Path:
    """Sweeps of eight at one inclination each, whose dial is off by so many degrees.

    Both axes scatter by `scatter` deg at every setting, readings by 0.5 mg.
    """
    rng = np.random.default_rng(seed)
    inclination = np.repeat(np.linspace(0.0, 75.0, len(off)), 8)
    tool_face = np.tile(np.arange(0.0, 360.0, 45.0), len(off))
    true = inclination + np.repeat(off + scatter * rng.standard_normal(len(off)), 8)
    i = np.radians(true)
    t = np.radians(tool_face + scatter * rng.standard_normal(tool_face.size))
    force = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)
    reading = 1000.0 * force + 0.5 * rng.standard_normal(force.shape)
    rows = np.column_stack([inclination, tool_face, reading])
    np.savetxt(
        path, rows, fmt="%.4f", delimiter=",", header="inclination,tool_face,x_mg,y_mg,z_mg",
        comments="",
    )  # fmt: skip
    return path


def fitted(path: Path) -> Fit:
    table = read_position_table(path)
    request = LabRequest(unit="mg", settings=LabSettings(loop=False))
    return fit(BASE, observations_of(table, raw_unit(table, "mg", None), request))


def test_four_settings_of_a_dial_that_is_off_are_told(tmp_path: Path) -> None:
    found = fitted(swept(tmp_path / "s.csv", np.array([0.4, 0.6, 0.75, 0.8])))
    (said,) = doubtful_dials(found, (), NOISE_ALPHA)
    assert said.driver == "inclination"
    assert "4 inclination settings" in said.name


@pytest.mark.parametrize(
    ("off", "scatter"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.05),  # nothing is off
        ([0.2, -0.3, 0.1, 0.4], 0.3),  # both axes are set as badly
        ([0.1, -0.05, 0.08, 0.0], 0.01),  # a tenth of a degree is what a bench may have
        (list(0.4 * np.sin(np.arange(12.0))), 0.05),  # twelve settings have a shape of their own
    ],
)
def test_other_benches_are_not_doubted(tmp_path: Path, off: list[float], scatter: float) -> None:
    found = fitted(swept(tmp_path / "s.csv", np.array(off), scatter))
    assert not doubtful_dials(found, (), NOISE_ALPHA)


def test_benches_of_equal_scatter_are_doubted_no_more_than_stated(tmp_path: Path) -> None:
    sheets = (swept(tmp_path / f"{seed}.csv", np.zeros(4), 0.15, seed) for seed in range(8))
    doubted = [bool(doubtful_dials(fitted(sheet), (), NOISE_ALPHA)) for sheet in sheets]
    assert not any(doubted)
