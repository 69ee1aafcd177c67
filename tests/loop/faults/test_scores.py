"""What slips of hand are worth, by the sum of squares that their repair leaves, written out; and
the limits by which a value, a converter or a column is told."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from imucalib.loop.faults.noise_grid import Base, Grid, base_of
from numpy.typing import NDArray

from imucalib.core.known_direction import KnownDirection
from imucalib.core.references import KnownVector
from imucalib.loop import record_errors
from imucalib.loop.faults import readings
from imucalib.loop.faults.angles import _sense, apart, rounded
from imucalib.loop.faults.cells import cells
from imucalib.loop.faults.conventions import Meaning, as_meant, linear_misfit, nearest_axes
from imucalib.loop.faults.converter import cut_off, mistaken_scale, step_of
from imucalib.loop.faults.found import Fault, Hypothesis, with_rivals
from imucalib.loop.faults.readings import blocks, exchanges, leading, records
from imucalib.loop.faults.sheet import Sheet, slopes
from worlds import sheets

Array = NDArray[np.float64]
N = 20


def inside(inclination: Array, tool_face: Array) -> tuple[Array, Array]:
    return np.deg2rad(inclination), np.deg2rad(tool_face)


def sheet(seed: int = 0, noise: float = 0.5) -> Sheet:
    """Sweeps of twenty rows, read by an ordinary sensor."""
    rng = np.random.default_rng(seed)
    i = np.repeat([-50.0, -10.0, 30.0, 70.0], 5)
    t = np.tile([0.0, 72.0, 144.0, 216.0, 288.0], 4) + np.repeat([0.0, 10.0, 20.0, 30.0], 5)
    truth = 1000.0 * sheets.direction(i, t)
    reading = truth * [1.01, 0.99, 1.005] + [5.0, -8.0, 3.0] + noise * rng.standard_normal((N, 3))
    at = np.arange(N)
    return Sheet(
        reading=reading, inclination=i, tool_face=t, row=at + 1, place=at, sigma=np.ones(N),
        gravity=1000.0, inclination_setting=at // 5, tool_face_setting=at, inside=inside,
        ordered=True,
    )  # fmt: skip


def with_slip(change: dict[int, Array]) -> Base:
    made = sheet()
    reading = made.reading.copy()
    for row, value in change.items():
        reading[row] = value
    base = base_of(made.with_reading(reading))
    assert base is not None
    return base


def worth(base: Base, reading: Array) -> float:
    """Nats that other readings are worth beyond those of the sheet, by the quadratic form."""
    y = reading.ravel()
    return float(base.best(np.einsum("i,gij,j->g", y, base.P, y)) - base.as_it_stands)


def test_an_exchange_is_worth_what_the_exchanged_sheet_leaves() -> None:
    plain = sheet().reading
    base = with_slip({3: plain[11], 11: plain[3]})
    found = exchanges(base)
    for one in found:
        due = worth(base, one.repaired.reading) - np.log(N * (N - 1) / 2)
        assert one.fault.score == pytest.approx(due, rel=1e-9)
    assert found[0].fault.line == "--swap 4,12"
    np.testing.assert_allclose(found[0].repaired.reading, plain)


def _neighbours_exchanged(value: float) -> float:
    text = f"{abs(value):.10g}"
    return float(np.sign(value)) * float(text[1] + text[0] + text[2:])


@pytest.mark.parametrize(
    ("slip", "words", "line"),
    [
        (lambda v: v * [-1.0, 1.0, 1.0], "x lost its sign", "--fix 8:x="),
        (lambda v: v * [1.0, 10.0, 1.0], "y is ten times too large", "--fix 8:y="),
        (lambda v: v * [1.0, 1.0, 0.1], "z is ten times too small", "--fix 8:z="),
        (lambda v: v[[1, 0, 2]], "x and y are exchanged", "--fix 8:x="),
        (lambda v: v[[0, 2, 1]], "y and z are exchanged", "--fix 8:y="),
        (lambda v: v[[2, 1, 0]], "x and z are exchanged", "--fix 8:x="),
        (
            lambda v: [v[0], _neighbours_exchanged(2.0 * v[1]) / 2.0, v[2]],
            "digits",
            "--fix 8:y=",
        ),
    ],
)
def test_a_cell_is_worth_what_the_mended_sheet_leaves(slip, words: str, line: str) -> None:  # type: ignore[no-untyped-def]
    plain = sheet().reading
    base = with_slip({7: slip(plain[7])})
    best, *rest = cells(base, 2.0 * base.sheet.reading)
    assert words in best.fault.what
    assert best.fault.line.startswith(line)
    np.testing.assert_allclose(best.repaired.reading, plain)
    shown = {t.split(":")[1][0]: float(t.split("=")[1]) for t in best.fault.line.split(" ")[1::2]}
    for axis, value in shown.items():  # in the sheet's own unit
        assert value == pytest.approx(2.0 * plain[7]["xyz".index(axis)])
    tried = 12 * N + sum(
        a != b
        for v in 2.0 * base.sheet.reading.ravel()
        for a, b in pairwise(f"0{abs(v):.10g}".replace(".", ""))
    )
    for one in (best, *rest):
        due = worth(base, one.repaired.reading) - np.log(tried)
        assert one.fault.score == pytest.approx(due, rel=1e-9)


def test_a_reading_that_belongs_nowhere_costs_its_distance() -> None:
    """Its row at the reading that fits best; three numbers fewer; a Cauchy density of 3 mg about
    it; one of twenty rows."""
    base = with_slip({5: np.array([300.0, -700.0, 200.0])})
    (one,) = records(base)
    assert one.fault.line == "--exclude 6"
    assert one.repaired.n == N - 1
    y = base.sheet.reading.ravel()
    rss, away = [], []
    for p in base.P:
        own, g = p[15:18, 15:18], (p @ y)[15:18]
        away.append(np.linalg.solve(own, g))
        rss.append(y @ p @ y - g @ away[-1])
        there = y.copy()
        there[15:18] -= away[-1]
        assert there @ p @ there == pytest.approx(rss[-1], rel=1e-4)
    each = base.each(np.array(rss) * 48.0 / 45.0)
    stray = 2.0 * np.log1p(np.sum(np.square(away), axis=1) / 18.0)
    due = (each - stray).max() - base.as_it_stands - np.log(N)
    assert one.fault.score == pytest.approx(due, rel=1e-9)


def test_a_moved_reading_and_a_shift_are_told_by_their_rows() -> None:
    plain = sheet().reading
    order = np.insert(np.delete(np.arange(N), 4), 12, 4)
    moved = with_slip({k: plain[order[k]] for k in range(N)})
    best = blocks(moved)[0]
    assert best.fault.line == "--move 13,5"
    np.testing.assert_allclose(best.repaired.reading, plain)
    tried = readings._orders(N, moved.sheet.beside())
    assert tried is not None
    count = 4 * sum(N - a - 2 for a in range(N - 2))
    assert len(tried.lost) == count
    due = worth(moved, best.repaired.reading) - np.log(count)
    assert best.fault.score == pytest.approx(due, rel=1e-9)
    late = plain.copy()
    late[8:] = plain[7:-1]
    shifted = blocks(with_slip({k: late[k] for k in range(N)}))
    assert "--shift readings:8-20=-1" in [one.fault.line for one in shifted]


def test_a_block_ends_where_a_row_is_left_out() -> None:
    """Blocks of three or more rows, each in two directions, moved or shifted."""
    tried = readings._orders(6, np.array([1, 1, 0, 1, 1]))
    assert tried is not None
    assert len(tried.lost) == 8
    assert set(zip(tried.first.tolist(), tried.last.tolist(), strict=True)) == {(0, 2), (3, 5)}
    assert readings._orders(2, np.ones(1, np.intp)) is None


def test_noise_and_scatter_have_a_price() -> None:
    """Ten mg of noise log 2; ten degrees of scatter 7 nats; one of what stands beside log 2."""

    def price(i: float, t: float, k: float, noise: float) -> float:
        return float(Grid(*(np.array([v]) for v in (i, t, k))).prior(np.array([noise]))[0])

    assert price(0.0, 0.0, 0.0, 10.0) == pytest.approx(-np.log(2.0))
    assert price(10.0, 0.0, 0.0, 1.0) - price(0.0, 0.0, 0.0, 1.0) == pytest.approx(-7.014, abs=1e-3)
    assert price(0.0, 10.0, 0.0, 1.0) == price(10.0, 0.0, 0.0, 1.0)
    assert price(0.0, 0.0, 1.0, 1.0) - price(0.0, 0.0, 0.0, 1.0) == pytest.approx(-np.log(2.0))


@pytest.mark.parametrize("n", [20, 60])
def test_the_likelihood_is_that_of_the_linear_bench(n: int) -> None:
    """Of differences whatever the twelve parameters, noise profiled: dense matrices, at one point
    of the grid."""
    rng = np.random.default_rng(1)
    i, t = rng.uniform(-80.0, 80.0, n), rng.uniform(0.0, 360.0, n)
    sigma = rng.uniform(0.5, 2.0, n)
    reading = 1000.0 * sheets.direction(i, t) + 3.0 * rng.standard_normal((n, 3))
    at = np.arange(n)
    made = Sheet(reading=reading, inclination=i, tool_face=t, row=at + 1, place=at, sigma=sigma,
                 gravity=1000.0, inclination_setting=at // 2, tool_face_setting=at, inside=inside,
                 ordered=False)  # fmt: skip
    base = base_of(made)
    assert base is not None
    assert len(base.c) == (108 if n == 20 else 4)
    assert base.dof == 3 * n - 12
    g = len(base.c) - 1
    terms, grid = base.terms, base.grid
    v = np.diag(np.repeat(sigma**2, 3)) + grid.inclination[g] ** 2 * (
        terms.inclination @ terms.inclination.T)  # fmt: skip
    v += grid.tool_face[g] ** 2 * terms.tool_face @ terms.tool_face.T
    v += grid.share[g] ** 2 * terms.beside @ terms.beside.T
    w = np.linalg.inv(v)
    x = terms.design
    p = w - w @ x @ np.linalg.inv(x.T @ w @ x) @ x.T @ w
    y = reading.ravel()
    assert base.rss[g] == pytest.approx(y @ p @ y, rel=1e-6)
    np.testing.assert_allclose(base.g[g], p @ y, atol=1e-8)
    # Log determinants, but for those of the weights.
    due = -0.5 * (np.linalg.slogdet(v)[1] + np.linalg.slogdet(x.T @ w @ x)[1])
    assert base.c[g] == pytest.approx(due + 3.0 * np.log(sigma).sum(), rel=1e-9)
    along = slopes(1000.0, *inside(i, t))
    step = 1e-4
    for k, moved in enumerate((1000.0 * sheets.direction(i + step, t),
                               1000.0 * sheets.direction(i, t + step))):  # fmt: skip
        np.testing.assert_allclose(
            (moved - 1000.0 * sheets.direction(i, t)) / step, along[k], atol=1e-3
        )


def test_only_what_is_sure_is_said_and_its_rivals_within_five_nats() -> None:
    assert leading(np.array([4.9, 1.0])).tolist() == []
    assert leading(np.array([5.1, 9.0, 12.1, 6.0, 7.2, 1.0])).tolist() == [2, 1, 4]
    made = sheet()

    def one(score: float, line: str) -> Hypothesis:
        return Hypothesis(Fault("cell", "", (1,), score, line), made)

    best = with_rivals([one(12.0, "b"), one(20.0, "a"), one(15.1, "c"), one(14.9, "d"),
                        one(19.0, "a")])  # fmt: skip
    assert best is not None
    assert (best.fault.line, best.fault.rivals) == ("a", ("c",))
    assert with_rivals([one(5.0, "a")]) is None


@pytest.mark.parametrize(
    ("value", "sd", "step", "shown"),
    [
        (119.2, 0.1, 10.0, 120.0),  # a dial may be off by two degrees
        (117.9, 0.1, 10.0, 117.5),  # else the next finer one: 2.5
        (117.9, 0.8, 10.0, 120.0),  # and by three sd
        (21.7, 0.1, 22.5, 22.5),
        (20.4, 0.1, 22.5, 20.0),
        (14.1, 0.1, 5.0, 15.0),  # a fifth of the step
        (13.9, 0.1, 5.0, 14.0),
        (7.32, 0.02, 0.5, 7.3),
        (7.44, 0.02, 0.5, 7.5),
        (-0.3, 0.2, 5.0, 0.0),
        (33.4, 1.2, 0.01, 33.4),
        (33.421, 0.001, 0.01, 33.42),
    ],
)
def test_a_typed_angle_is_shown_on_the_columns_steps(
    value: float, sd: float, step: float, shown: float
) -> None:
    column = step * np.arange(1.0, 30.0)
    assert rounded(value, sd, column) == pytest.approx(shown)


def test_a_step_is_that_of_nine_tenths_of_the_column() -> None:
    column = np.concatenate([np.full(9, 30.0), [31.234]])
    assert rounded(29.5, 0.1, column) == 30.0
    assert rounded(29.5, 0.1, np.append(column, 31.234)) == 29.5
    assert rounded(29.54, 2.0, np.append(column, 31.234)) == 30.0


def test_tool_faces_are_apart_by_the_shorter_way() -> None:
    assert apart(np.array([350.0, 190.0]), 10.0, 1).tolist() == [20.0, 180.0]
    assert apart(np.array([350.0, 190.0]), 10.0, 0).tolist() == [340.0, 180.0]
    base = base_of(sheet())
    assert base is not None
    assert (_sense(base, 3, 0), _sense(base, 3, 1)) == (1.0, 1.0)


def test_a_converter_ends_where_three_readings_repeat_and_more_was_due() -> None:
    rng = np.random.default_rng(0)
    truth = 1000.0 * sheets.direction(rng.uniform(-80, 80, 40), rng.uniform(0, 360, 40))

    def of(at: float, *, known: bool, rows: int = 40, step: float = 0.0) -> list[tuple[int, float]]:
        reading = step * np.round(truth[:rows] / step) if step else truth[:rows].copy()
        reading[:, 1] = np.minimum(reading[:, 1], at)
        return [(c.axis, c.value) for c in cut_off(reading, truth[:rows] if known else None)]

    top = np.sort(truth[:, 1])[::-1]
    assert of(top[2] - 25.0, known=True) == [(1, top[2] - 25.0)]
    assert of(top[2] - 1.0, known=True) == [(1, top[2] - 1.0)]  # nothing else repeats
    rounded = 3.0 * np.round((top[2] - 1.0) / 3.0)
    assert of(rounded, known=True, step=3.0) == []  # such readings repeat by themselves
    assert of(top[1] + 1e-6, known=True) == []  # one reading alone
    assert of(top[4] - 120.0, known=False) == [(1, top[4] - 120.0)]
    half = 300.0 * np.round(np.median(truth[:10, 1]) / 300.0)
    assert of(half, known=True, rows=10, step=300.0) == []  # too few others


@pytest.mark.parametrize("known", [True, False])
def test_all_axes_end_at_one_range(known: bool) -> None:
    """Level and upside down each axis is at its end once: no reading repeats on its own axis."""
    rng = np.random.default_rng(2)
    truth = np.vstack([
        [[0, 1000, 3], [1000, 0, 1], [0, -1000, 7], [-1000, 0, 2]],
        1000.0 * sheets.direction(rng.uniform(30, 60, 24), rng.uniform(0, 360, 24)),
    ])  # fmt: skip
    high = np.minimum(truth, 960.0)
    cut = np.maximum(high, -960.02)  # a count more on the other side
    found = cut_off(cut, truth if known else None)
    assert {(c.axis, c.value) for c in found} == {
        (0, 960.0),
        (1, 960.0),
        (0, -960.02),
        (1, -960.02),
    }
    assert not cut_off(truth + rng.normal(0.0, 1.0, truth.shape), truth if known else None)
    apart = np.minimum(np.maximum(truth, [-960.0, -950.0, -1e9]), [970.0, 940.0, 1e9])
    assert not cut_off(apart, truth if known else None)


def test_wide_steps_are_of_three_mg_and_of_all_values() -> None:
    rng = np.random.default_rng(0)
    plain = rng.uniform(-1000.0, 1000.0, (300, 3))
    assert step_of(3.1 * np.round(plain / 3.1)) == pytest.approx(3.1)
    assert step_of(2.9 * np.round(plain / 2.9)) == 0.0
    off = 3.1 * np.round(plain / 3.1)
    off[:3, 0] += 1.3
    assert step_of(off) == 0.0
    assert step_of(np.array([[0.0, 5.0, 10.0], [15.0, 20.0, 25.0], [30.0, 0.0, 5.0]])) == 0.0


def test_a_guessed_unit_is_mistaken_by_the_likelihood_of_three_scales() -> None:
    """Half way between 1000 and 1024 counts a g, in the logarithm."""
    half = np.sqrt(1.024)
    assert mistaken_scale("mg", np.full(3, half * 1.001 - 1.0)) == 1024.0
    assert mistaken_scale("mg", np.full(3, half * 0.999 - 1.0)) is None
    low = np.sqrt(0.980665)
    assert mistaken_scale("mg", np.full(3, low * 0.999 - 1.0)) == 980.665
    assert mistaken_scale("mg", np.full(3, low * 1.001 - 1.0)) is None
    assert mistaken_scale("ug", np.full(3, 0.048576)) == 1048576.0
    assert mistaken_scale("g", np.full(3, 0.024)) is None


def test_a_column_may_mean_something_else() -> None:
    made = sheet()
    assert np.array_equal(as_meant(made, Meaning(exchanged=True)).inclination, made.tool_face)  # type: ignore[union-attr]
    np.testing.assert_allclose(as_meant(made, Meaning(vertical=True)).inclination,  # type: ignore[union-attr]
                               90.0 - made.inclination)  # fmt: skip
    assert as_meant(made, Meaning(radians=True)) is None  # far beyond two turns
    late = as_meant(made, Meaning(tool_face_steps=1))
    assert late is not None
    assert late.row.tolist() == list(range(2, 21))
    np.testing.assert_allclose(late.tool_face, made.tool_face[:-1])
    np.testing.assert_allclose(late.inclination, made.inclination[1:])
    early = as_meant(made, Meaning(inclination_steps=-1))
    assert early is not None
    np.testing.assert_allclose(early.inclination, made.inclination[1:])
    # Length of what four columns leave, a degree of freedom each.
    x = np.column_stack([made.truth(), np.ones(N)])
    left = np.linalg.lstsq(x, made.reading, rcond=None)[1].sum()
    assert linear_misfit(made) == pytest.approx(np.sqrt(left / 16.0))
    axes = nearest_axes(made.with_reading(made.reading[:, [1, 0, 2]] * [1.0, -1.0, 1.0]))
    assert axes is not None
    assert (axes.text, axes.mirrored) == ("-y,x,z", False)
    assert axes.angle < 1.0
    assert nearest_axes(made.with_reading(made.reading * [1, 1, -1])).mirrored  # type: ignore[union-attr]


def test_how_far_a_record_stood_from_its_setting(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the corrected reading; tool-face the shorter way round; a direction by its angle."""
    from types import SimpleNamespace

    ids = np.arange(1)
    i, t = np.radians([30.0]), np.radians([359.0])
    read = 9.8 * sheets.direction(np.array([31.5]), np.array([1.0]))
    monkeypatch.setattr(record_errors, "_corrected_without", lambda fit, row: read)
    known = SimpleNamespace(observations=SimpleNamespace(
        reference=KnownVector(i, t, 9.8, ids, ids)))  # fmt: skip
    away = [np.degrees(record_errors._angle_away(known, 0, f"{name} setting"))  # type: ignore[arg-type]
            for name in ("inclination", "tool-face")]  # fmt: skip
    assert away == pytest.approx([1.5, 2.0])
    turned = KnownDirection(sheets.direction(np.array([30.0]), np.array([1.0])), 9.8)
    known.observations.reference = turned
    found = np.degrees(record_errors._angle_away(known, 0, "tilt"))  # type: ignore[arg-type]
    assert found == pytest.approx(1.5)
