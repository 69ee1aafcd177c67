"""Six faces and other directions without dials, and intervals that hold with few rows."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gates.bounds import at_most
from imucalib.arrays import Array
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.errors import Undetermined, UnreadableInput, UsageError
from worlds.command import run
from worlds.places import script

TRUTH = {
    "mounting_x": 0.4, "mounting_y": -0.7, "mounting_z": 1.1,  # deg
    "bias_x": 25.0, "bias_y": -18.0, "bias_z": 32.0,  # mg
    "scale_x": 0.006, "scale_y": -0.004, "scale_z": 0.009,
    "cross_yx": 0.003, "cross_zx": -0.002, "cross_zy": 0.004,
}  # fmt: skip
FACES = ("+x", "+y", "+z", "-x", "-y", "-z")
NOISE_MG, TILT_DEG = 1.0, 0.2


def readings(direction: Array, rng: np.random.Generator) -> Array:
    """(n, 3) mg: lower triangle times mounting (about x, then y, then z), on tilted directions."""
    t = TRUTH
    lower = np.diag([1.0 + t[f"scale_{a}"] for a in "xyz"])
    lower[[1, 2, 2], [0, 0, 1]] = t["cross_yx"], t["cross_zx"], t["cross_zy"]
    mounting = Rotation.from_euler("xyz", [t[f"mounting_{a}"] for a in "xyz"], degrees=True)
    drawn = rng.standard_normal(direction.shape)
    across = drawn - np.sum(drawn * direction, axis=1, keepdims=True) * direction
    tilted = direction + np.radians(TILT_DEG) * across
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    noise = NOISE_MG * rng.standard_normal(direction.shape)
    return 1000.0 * mounting.apply(tilted) @ lower.T + [t[f"bias_{a}"] for a in "xyz"] + noise


def six_faces(seed: int, repeats: int) -> PositionTable:
    direction = np.tile(np.vstack([np.eye(3), -np.eye(3)]), (repeats, 1))
    return _table(direction, readings(direction, np.random.default_rng(seed)))


def _table(direction: Array, raw: Array) -> PositionTable:
    columns = {a: raw[:, k] for k, a in enumerate("xyz")}
    columns |= {f"u{a}": direction[:, k] for k, a in enumerate("xyz")}
    rows = np.arange(1, len(raw) + 1)
    return PositionTable(
        columns, {r: r for r in columns}, dict.fromkeys("xyz", "mg"), rows, "t", ""
    )


def calibrated(table: PositionTable, **changes: object) -> LabRun:
    return run_lab(table, LabRequest(reference="direction", **changes))  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_clean_table_accuses_no_row_and_its_intervals_hold() -> None:
    """Tables of 12, 18 and 24 rows in turn."""
    runs = [calibrated(six_faces(seed, 2 + seed % 3)) for seed in range(40)]
    loops = [run.result.loop for run in runs]
    alarms = sum(bool(loop and (loop.records or loop.steps)) for loop in loops)
    assert alarms <= at_most(40, 0.05).most
    hit, z = [], []
    for one in runs:
        fit = one.result.base
        assert {p.name for p in fit.parameters} == set(TRUTH)
        off = fit.theta - [TRUTH[p.name] for p in fit.parameters]
        hit.append(np.abs(off) <= [fit.half_width(row) for row in np.eye(fit.theta.size)])
        z.append(off / fit.sd)
    assert 0.90 <= np.mean(hit) <= 0.98
    # No parameter is off in one direction: its mean error within 4 sd of a mean.
    assert np.abs(np.mean(z, axis=0)).max() < 4.0 / np.sqrt(len(runs))


def test_exchanged_faces_are_named_and_the_lines_mend_them(tmp_path: Path) -> None:
    """Two rows exchanged and a third under a wrong face: the fit alone did not settle."""
    faces = list(FACES * 4)
    faces[7], faces[8], faces[13] = faces[8], faces[7], "-z"
    path = _written(tmp_path, 4, tuple(faces))
    lines = ("--swap", "8,9", "--fix", "14:face=+y")
    told = run("lab", path, "--reference", "direction", "-o", tmp_path / "a", "--full")
    words = " ".join(told.output.replace("\\\n", " ").split())
    assert all(" ".join(pair) in words for pair in (lines[:2], lines[2:]))
    mended = run("lab", path, "--reference", "direction", "-o", tmp_path / "b", "-q", *lines)
    assert mended.return_value == 0, mended.output


def test_what_a_table_of_faces_cannot_do() -> None:
    with pytest.raises(UsageError, match="needs known angles"):
        calibrated(six_faces(1, 2), objective="paper")
    whole = six_faces(1, 3)
    rows = np.flatnonzero(whole.columns["uz"] == 0.0)
    part = {role: values[rows] for role, values in whole.columns.items()}
    with pytest.raises(Undetermined, match="each axis up and down"):
        calibrated(replace(whole, columns=part, row=np.arange(1, 13)))
    part["ux"][4], part["uy"][4] = 0.0, 0.0
    with pytest.raises(UnreadableInput, match="no direction") as caught:
        calibrated(replace(whole, columns=part, row=np.arange(1, 13)))
    assert caught.value.where == "t, row 5"


def _written(folder: Path, repeats: int = 2, faces: tuple[str, ...] = FACES) -> Path:
    raw = six_faces(1, repeats).raw()
    lines = ["face,x_mg,y_mg,z_mg"]
    for k, row in enumerate(raw):
        lines.append(",".join([faces[k % len(faces)], *(f"{v:.4f}" for v in row)]))
    path = folder / "six.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_end_to_end(tmp_path: Path) -> None:
    path, out = _written(tmp_path), tmp_path / "out"
    result = run("lab", path, "--reference", "direction", "-o", out, "--json", "-q")
    assert result.return_value == 0
    report = json.loads(result.stdout)
    assert report["loop"]["errors"][0]["metric"] == "vector error, rms"
    assert 0.05 < report["noise"]["tilt_deg"] < 0.4
    values = {p["name"]: (p["value"], p["sd"]) for p in report["parameters"]}
    assert all(abs(values[n][0] - true) < 4.5 * values[n][1] for n, true in TRUTH.items())
    html = (out / "report.html").read_text(encoding="utf-8")
    assert "tilt" in html
    assert "deg scatter" in html
    assert run("validate", out / "calibration.yaml").return_value == 0


SHEETS = script("benchmarks/lab/few_rows.py")


@pytest.mark.parametrize(
    "kind",
    [
        "6 rows",
        *(
            pytest.param(k, marks=pytest.mark.slow)
            for k in ("9 rows", "12 rows", "six faces", "twice")
        ),
    ],
)
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
        run = run_lab(table, LabRequest(reference=reference, gravity=SHEETS.G, loop=False))
        bias = [p.sd for p in run.calibration.parameters if p.name.startswith("bias")]
        assert min(bias) > 0.1
        assert run.outcome.advice[0].startswith("Take every position twice")


def test_an_interval_wider_than_a_circle_is_no_number() -> None:
    """Paper 004's own objective leaves a combination open: that is said, not 867 deg."""
    from imucalib.calibrators.lab.position_table import read_position_table
    from imucalib.calibrators.lab.request import as_published
    from imucalib.report.lab import compose_lab_document
    from worlds.places import SAMPLES

    table = read_position_table(SAMPLES / "paper_table_1.csv")
    run = run_lab(table, as_published(LabRequest(fixes=((10, "y", -58593.0),))))
    card = compose_lab_document(run).card
    assert card is not None
    angles = [w.value for w in card.good_to if "one reading" in w.detail]
    assert angles == ["not determined", "not determined"]
