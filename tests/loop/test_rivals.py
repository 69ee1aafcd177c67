"""Names as a reader reads them, and what has none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.position_table import read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import run_lab
from imucalib.effects.shape import in_words


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("curve@bias:tool_face:0:5.235987756:6", "a curve of the bias against tool face"),
        ("shape@response:xyz:soft_saturation:0.3", "a soft saturation of the response"),
        ("follows@scale:supply_V:12:0.5", "scale follows supply_V"),
        ("converter@xyz", "converter, xyz"),
        ("squares_across", "squares across"),
        ("slip@record18:z", "slip, record 18, z"),
        ("thermal_lag@1.5h", "thermal lag, 1.5 h"),
        ("thermal_hysteresis@2C", "thermal hysteresis, 2 °C"),
    ],
)
def test_names_for_a_reader(name: str, words: str) -> None:
    assert in_words(name) == words


def _creeping(path: Path, seed: int) -> Path:
    """Six rings of six; after each new inclination the bias settles, which no effect says."""
    rng = np.random.default_rng(seed)
    ring, place = np.repeat(np.arange(6), 6), np.tile(np.arange(6), 6)
    inclination, tool_face = 15.0 * ring, 60.0 * place
    i = np.deg2rad(inclination + 0.05 * rng.standard_normal(6)[ring])
    t = np.deg2rad(tool_face + 0.05 * rng.standard_normal(36))
    warm = 22.0 + 10.0 * (1.0 - np.exp(-np.arange(36) / 16.0)) + 0.2 * rng.standard_normal(36)
    force = np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=1)
    along = rng.standard_normal(3)
    settling = 6.0 * np.exp(-place / 1.5)[:, None] * along / np.linalg.norm(along)
    reading = 1000.0 * force * [1.004, 0.997, 1.002] + [12.0, -7.0, 3.0] + settling
    reading += 0.6 * rng.standard_normal((36, 3))
    heading = "inclination,tool_face,temperature_C,x_mg,y_mg,z_mg"
    rows = np.column_stack([inclination, tool_face, warm, reading])
    np.savetxt(path, rows, "%.6g", ",", header=heading, comments="")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_what_settles_after_each_setting_is_nothing_certain(tmp_path: Path, seed: int) -> None:
    sheet = _creeping(tmp_path / "sheet.csv", seed)
    loop = run_lab(read_position_table(sheet), LabRequest()).result.loop
    assert loop is not None
    assert not any(s.certain for s in loop.steps)  # what is left of it may look like anything
