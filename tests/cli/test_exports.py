"""`--export` beside a calibration: what loses too much is left out, and said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from click.testing import CliRunner, Result

from imucalib.cli import cli as root

G = 9.80665


def run(*arguments: object) -> Result:
    return CliRunner().invoke(root, [str(a) for a in arguments], standalone_mode=False)


def skewed(path: Path) -> Path:
    """Norms of a sensor whose axes are 3° off square, in g, with hardly any noise."""
    rng = np.random.default_rng(4)
    force = rng.normal(size=(30, 3))
    force /= np.linalg.norm(force, axis=1, keepdims=True)
    reading = force @ np.array([[1, 0, 0], [0.05, 1, 0], [0, 0.05, 1.0]]).T
    reading += 1e-5 * rng.normal(size=reading.shape)
    rows = "\n".join(",".join(f"{v:.7f}" for v in row) for row in reading)
    path.write_text(f"ax_g,ay_g,az_g\n{rows}\n")
    return path


def test_a_form_that_loses_too_much_is_left_out_and_the_rest_is_written(tmp_path: Path) -> None:
    table, out = skewed(tmp_path / "norms.csv"), tmp_path / "out"
    usual = ("lab", table, "--reference", "norm", "--no-loop", "-q", "--export", "c-header")
    result = run(*usual, "--export", "px4", "-o", out)
    assert result.exception is None, result.exception
    assert result.return_value == 1
    assert "error: px4 loses" in result.stderr
    assert "--force" in result.stderr
    assert {p.name for p in out.iterdir()} == {
        "calibration.yaml", "report.html", "report.json", "imucal_calibration.h"
    }  # fmt: skip
    forced = run(*usual, "--export", "px4", "-o", out, "--force")
    assert forced.return_value == 0
    assert (out / "imucal_px4.params").read_text().count("\tCAL_ACC0_") == 6
