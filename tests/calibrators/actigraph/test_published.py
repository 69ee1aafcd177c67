"""Paper 002's own procedure: points, descent in every arithmetic, comparisons, verification."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibration.file import read as read_calibration
from imucalib.calibrators.actigraph.published import PointCollector
from imucalib.calibrators.actigraph.simulation import WeekPlan
from imucalib.errors import Undetermined
from imucalib.estimators.gradient_descent import (
    INT16,
    INT32,
    RATES,
    START,
    FixedPoint,
    descend,
    descend_fixed,
    norm_errors,
    objective,
    solve_closed_form,
)
from imucalib.units import MG, STANDARD_GRAVITY
from imucalib.writers import write
from worlds.command import run
from worlds.week import simulated_blocks


def case(seed: int, noise: float = 1e-3, off_diagonal: float = 0.05) -> tuple[Array, Array]:
    """p and 18 points by the nine-bin rule: section III.A, with eq. (19)'s sign put right."""
    rng = np.random.default_rng(seed)
    s = 1.0 + rng.uniform(-0.1, 0.1, 3)
    t = rng.uniform(-off_diagonal, off_diagonal, 3)
    o = rng.uniform(-0.1, 0.1, 3)
    p = np.concatenate([s, [s[1] * t[0], s[2] * t[1], s[2] * t[2]], o])
    gain = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    points = PointCollector()
    while not points.ready:
        truth = rng.standard_normal(3)
        point = np.linalg.solve(gain, truth / np.linalg.norm(truth)) - o
        points.offer(point + noise * rng.standard_normal(3))
    return p, np.array(points.points)


def test_the_printed_sum_diverges_and_the_mean_does_not() -> None:
    _, points = case(1)
    p = START.copy()
    for _ in range(50):
        here = objective(p, points)
        slope = [(objective(p + 1e-5 * e, points) - here) / 1e-5 for e in np.eye(9)]
        p = p - RATES * len(points) * np.array(slope)
        if not np.isfinite(p).all() or np.abs(p).max() > 1e3:
            break
    else:
        pytest.fail("eq. (12) as printed should diverge")
    assert np.abs(norm_errors(descend(points), points)).max() < 0.01


def one_number_at_a_time(points: Array, form: FixedPoint, iterations: int) -> list[int]:
    """The same arithmetic as a microcontroller's loops, in Python's exact integers."""

    def shifted(value: int) -> int:
        return (value + (1 << (form.fraction - 1))) >> form.fraction

    v = [[round(float(c) * form.one) for c in point] for point in points]
    p = [form.one] * 3 + [0] * 6
    rates = [round(float(r) * form.one) for r in RATES]

    def total(p: list[int]) -> int:
        out = 0
        for point in v:
            x, y, z = (point[k] + p[6 + k] for k in range(3))
            a = shifted(p[0] * x)
            b = shifted(p[3] * x + p[1] * y)
            c = shifted(p[4] * x + p[5] * y + p[2] * z)
            excess = shifted(a * a + b * b + c * c) - form.one
            out += excess * excess
        assert out < 1 << (2 * form.bits - 1)
        return out

    for _ in range(iterations):
        here = total(p)
        slope = []
        for k in range(9):
            change = total([x + form.step * (i == k) for i, x in enumerate(p)]) - here
            divisor = form.step * len(v)
            size = (abs(change) + divisor // 2) // divisor
            slope.append(size if change >= 0 else -size)
        p = [x - shifted(r * g) for x, r, g in zip(p, rates, slope, strict=True)]
    return p


@pytest.mark.parametrize("form", [INT32, INT16], ids=["int32", "int16"])
def test_fixed_point_is_exact_to_the_bit(form: FixedPoint) -> None:
    for seed in range(3):
        _, points = case(seed)
        exact = one_number_at_a_time(points, form, 50)
        assert np.array_equal(descend_fixed(points, form) * form.one, exact)


def test_the_closed_form_is_exact_without_misalignment() -> None:
    p, points = case(4, noise=0.0, off_diagonal=0.0)
    assert np.allclose(solve_closed_form(points), p, atol=1e-9)
    with pytest.raises(Undetermined):
        solve_closed_form(np.array([[1.0, 0, 0]] * 18))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("published") / "days.h5"
    plan = WeekPlan(days=1.0, rate=20.0)
    (whole,) = simulated_blocks(plan, 3, block=plan.days * 86400.0)
    write(whole, path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("arithmetic", ["float", "int32", "int16"])
def test_as_published_writes_and_verifies(recording: Path, tmp_path: Path, arithmetic: str) -> None:
    how = ("-q", "--as-published", "--arithmetic", arithmetic)
    result = run("actigraph", recording, "-o", tmp_path, *how)
    assert result.exception is None
    assert result.return_value == 0
    report = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert len(report["points_g"]) == len(report["control_points_g"]) == 18
    methods = report["methods"]
    assert methods["gradient descent"]["improvement_percent"] > 200.0
    assert methods["global"]["fitted_mg"] <= methods["gradient descent"]["fitted_mg"] + 1e-3
    corrected = read_calibration(tmp_path / "calibration.yaml").apply(
        np.array(report["control_points_g"]) * STANDARD_GRAVITY, unit="m/s2"
    )
    error = np.abs(np.linalg.norm(corrected, axis=1) - STANDARD_GRAVITY).mean() / MG
    names = {"float": "", "int32": ", 32-bit", "int16": ", 16-bit"}
    chosen = methods[f"gradient descent{names[arithmetic]}"]
    assert error == pytest.approx(chosen["verified_mg"], rel=1e-6)
