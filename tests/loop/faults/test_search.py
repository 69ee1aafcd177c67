"""Slips of hand: found in simulated sheets, not claimed in clean ones, with exact arithmetic."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imucalib.loop.faults.noise_grid import base_of
from imucalib.loop.faults.search import row_faults

from gates.bounds import at_most
from imucalib.loop.faults.angles import _density, _others, dial_of, rounded
from imucalib.loop.faults.conventions import misread_angles, nearest_axes
from imucalib.loop.faults.converter import cut_off, mistaken_scale, step_of
from imucalib.loop.faults.found import Fault
from imucalib.loop.faults.readings import exchanges
from imucalib.loop.faults.sheet import Sheet, in_order
from worlds import sheets
from worlds.places import SAMPLES

TABLE_1 = SAMPLES / "paper_table_1.csv"
ROWS = (
    "exchange", "angle", "sign", "factor ten", "cells", "digits", "move", "shift", "setting",
    "part",
)  # fmt: skip
IN_ORDER = ("move", "shift", "setting", "part")


def inside(inclination: np.ndarray, tool_face: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.deg2rad(inclination), np.deg2rad(tool_face)


def sheet_of(made: sheets.Sheet, row: np.ndarray | None = None) -> Sheet:
    i, t = made.inclination, made.tool_face
    ordered = in_order(*inside(i, t))
    numbers = np.arange(len(i))

    def held(angle: np.ndarray) -> np.ndarray:
        return np.cumsum(np.append(0, np.diff(angle) != 0.0)) if ordered else numbers

    row = numbers + 1 if row is None else row
    one = np.ones(len(i))
    return Sheet(
        reading=made.reading,
        inclination=i,
        tool_face=t,
        row=row,
        place=row - 1,
        sigma=one,
        gravity=1000.0,
        inclination_setting=held(i),
        tool_face_setting=held(t),
        inside=inside,
        ordered=ordered,
    )


def told(made: sheets.Sheet) -> tuple[Fault, ...]:
    return row_faults(sheet_of(made), made.reading)


def table_1(sign_of_row_10: float = -1.0) -> sheets.Sheet:
    printed = np.genfromtxt(TABLE_1, delimiter=",", skip_header=3)
    reading = printed[:, 2:] / 1000.0
    reading[9, 1] *= sign_of_row_10
    return sheets.Sheet(printed[:, 0], printed[:, 1], reading)


def bench(seed: int, ordered: bool = False) -> sheets.Sheet:
    """A bench with any effect, noise and scatter."""
    rng = np.random.default_rng(seed)
    names = sheets.LAYOUTS[:2] if ordered else sheets.LAYOUTS
    return sheets.bench(
        seed,
        name=names[seed % len(names)],
        effect=str(rng.choice(sheets.EFFECTS)),
        noise=str(rng.choice(sheets.NOISES)),
        scatter=float(rng.choice([0.0, 0.1, 0.3])),
    )


@pytest.mark.parametrize("kind", ROWS)
def test_a_slip_is_found_with_the_line_that_undoes_it(kind: str) -> None:
    for seed in range(2):
        made = bench(seed, ordered=kind in IN_ORDER)
        made = sheets.slipped(made, kind, np.random.default_rng(seed))
        (fault,) = told(made)
        assert made.slip.line in (fault.line, *fault.rivals), (seed, made.slip, fault)
        assert fault.score > 5.0
        assert fault.line in fault.sentence


def test_clean_sheets_are_left_alone() -> None:
    said = [told(bench(seed)) for seed in range(100, 109)]
    assert not any(said)


def _level_rows(amount: float) -> sheets.Sheet:
    """A sheet that begins at inclination 0, where z reads -amount mg in three rows and about
    amount in the others."""
    made = sheets.bench(5, name="sweeps", scatter=0.0, sigma=0.3)
    level = np.flatnonzero(made.inclination == 0.0)
    order = np.concatenate([level, np.setdiff1d(np.arange(len(made.inclination)), level)])
    reading = made.reading[order] - [0.0, 0.0, np.median(made.reading[level, 2]) - amount]
    reading[:3, 2] = -amount
    turned = {"inclination": made.inclination[order], "tool_face": made.tool_face[order]}
    return replace(made, **turned, reading=reading)


def test_an_axis_that_stood_level_was_not_exchanged() -> None:
    """Some mg of the other sign are a drift's, or a row's, not a cable's."""
    assert not [fault for fault in told(_level_rows(20.0)) if fault.kind == "axes"]


@pytest.mark.parametrize("amount", [3.0, 8.0])
def test_no_line_tells_what_the_sheet_has(amount: float) -> None:
    made = _level_rows(amount)
    faults = [fault for fault in told(made) if fault.kind == "angle"]
    assert faults
    for fault in faults:
        row, _, change = fault.line.removeprefix("--fix ").partition(":")
        column, _, value = change.partition("=")
        assert abs(getattr(made, column)[int(row) - 1] - float(value)) >= 1.0


def test_two_slips_are_both_told() -> None:
    made = sheets.exchanged(bench(3), 4, 20)
    made = sheets.cell(made, 12, int(np.argmax(np.abs(made.reading[11]))), -1.0)
    assert {f.line.split("=")[0].split(":")[0] for f in told(made)} == {"--swap 4,20", "--fix 12"}


def test_the_papers_table() -> None:
    """Its one misprint is named; repaired, nothing is; each kind of slip in it is found."""
    (fault,) = told(table_1(1.0))
    assert fault.line == "--fix 10:y=-58.593"
    assert not told(table_1())
    rng = np.random.default_rng(4)
    for _ in range(2):
        made = sheets.slipped(table_1(), "exchange", rng)
        assert [f.line for f in told(made)] == [made.slip.line]
    for row, by in ((2, 5.0), (17, -10.0), (28, 60.0)):
        made = sheets.mistyped(table_1(), row, "inclination", by)
        assert [f.line for f in told(made)] == [made.slip.line]
    made = sheets.mistyped(table_1(), 14, "tool_face", 10.0)  # 130 for 120
    (fault,) = told(made)
    assert fault.line == "--fix 14:tool_face=120"
    assert "130 on the sheet where the reading says 1" in fault.what


def test_the_order_of_the_rows_says_nothing_but_in_blocks() -> None:
    made = sheets.exchanged(bench(1), 3, 17)
    order = np.random.default_rng(0).permutation(len(made.reading))
    mixed = sheets.Sheet(made.inclination[order], made.tool_face[order], made.reading[order])
    assert sheet_of(made).ordered
    assert not sheet_of(mixed).ordered
    (fault,) = row_faults(sheet_of(mixed, order + 1), made.reading)
    assert sorted(fault.rows) == [3, 17]


def test_a_change_of_readings_is_exact() -> None:
    """What the closed form says of an exchange is what the changed readings give."""
    sheet = sheet_of(sheets.exchanged(bench(2), 5, 9))
    base = base_of(sheet)
    assert base is not None
    (best, *_) = exchanges(base)
    y = best.repaired.reading.ravel()
    rss = np.einsum("i,gij,j->g", y, base.P, y)
    pairs = sheet.n * (sheet.n - 1) / 2
    direct = float(base.best(rss)) - base.as_it_stands - np.log(pairs)
    assert best.fault.score == pytest.approx(direct, abs=1e-6)


def test_the_down_date_is_the_likelihood_of_the_whole_sheet() -> None:
    """Rows in no order: every setting is a row's own, so the two ways are the same number."""
    made = sheets.bench(8, name="spread", scatter=0.1)
    sheet = sheet_of(made)
    base = base_of(sheet)
    assert base is not None
    others = _others(base)
    for row in (0, 7, 20):
        p = _density(base, others[row], row, 0, sheet.inclination[[row]])
        assert p[0] == pytest.approx(base.as_it_stands, abs=0.3)  # noise's prior lacks the row


def test_no_value_of_an_angle_exceeds_its_bound() -> None:
    """Rows are passed over by it, so that it must hold for every row and every value."""
    base = base_of(sheet_of(sheets.bench(8, scatter=0.1)))
    assert base is not None
    others = _others(base)
    for row in (0, 7, 20):
        for column, dial in ((0, np.arange(-90.0, 91.0)), (1, np.arange(0.0, 360.0))):
            assert _density(base, others[row], row, column, dial).max() <= others[row].most


@pytest.mark.parametrize(
    ("value", "sd", "shown"), [(118.6, 0.8, 120.0), (33.1, 0.2, 33.1), (-0.2, 0.3, 0.0)]
)
def test_values_are_rounded_to_the_steps_of_the_column(
    value: float, sd: float, shown: float
) -> None:
    set_to = np.arange(0.0, 360.0, 30.0)
    if shown == 33.1:
        set_to = set_to + 0.1 * np.arange(12.0)
    assert rounded(value, sd, set_to) == pytest.approx(shown)


@pytest.mark.parametrize("kind", sorted(sheets.WHOLE))
def test_columns_that_mean_something_else(kind: str) -> None:
    for seed in range(3):
        made = sheets.WHOLE[kind](bench(seed))
        sheet = sheet_of(made)
        found = misread_angles(sheet)
        if kind == "sense":  # no misfit shows a mirror
            axes = nearest_axes(sheet)
            assert found is None
            assert axes is not None
            assert axes.mirrored
            continue
        assert found is not None
        flags = (found.meaning.exchanged, found.meaning.radians, found.meaning.vertical)
        assert flags == (kind == "angles", kind == "radians", kind == "vertical")
        assert not found.meaning.inclination_steps
        assert not found.meaning.tool_face_steps


def test_angles_of_a_clean_sheet_mean_what_they_say() -> None:
    for seed in range(30):
        sheet = sheet_of(bench(seed))
        assert misread_angles(sheet) is None
        axes = nearest_axes(sheet)
        assert axes is not None
        assert axes.straight


def test_a_converter_at_its_end_and_in_steps() -> None:
    clean = bench(5).reading
    cut = clean.copy()
    cut[:, 2] = np.minimum(cut[:, 2], 0.5 * cut[:, 2].max())
    (end,) = cut_off(cut)
    assert (end.axis, end.value) == (2, pytest.approx(0.5 * clean[:, 2].max()))
    assert set(end.rows) == set(np.flatnonzero(clean[:, 2] >= end.value))
    assert not cut_off(clean)
    assert not cut_off(20.0 * np.round(clean / 20.0), sheet_of(bench(5)).truth())
    assert step_of(16.0 * np.round(clean / 16.0)) == pytest.approx(16.0)
    assert step_of(np.round(clean)) == 0.0
    assert step_of(clean) == 0.0


def test_1024_counts_are_no_mg() -> None:
    rng = np.random.default_rng(0)
    right = [mistaken_scale("mg", 0.007 * rng.standard_normal(3)) for _ in range(200)]
    wrong = [
        mistaken_scale("mg", 1.024 * (1.0 + 0.007 * rng.standard_normal(3)) - 1.0) for _ in right
    ]
    assert sum(r is not None for r in right) <= at_most(200, 0.01).most
    assert sum(w != 1024.0 for w in wrong) <= at_most(200, 0.01).most
    assert mistaken_scale("g", np.full(3, 0.024)) is None


def test_the_dial_shows_whole_degrees() -> None:
    """Tool-face a turn, from where the sheet begins; inclination to 90, of the vertical to 180."""
    assert dial_of(1, np.array([0.0, 350.0])).tolist() == [float(k) for k in range(360)]
    assert dial_of(1, np.array([-170.0, 90.0])).tolist() == [float(k) for k in range(-180, 180)]
    assert dial_of(0, np.array([-80.0, 90.0])).tolist() == [float(k) for k in range(-90, 91)]
    assert dial_of(0, np.array([10.0, 170.0])).tolist() == [float(k) for k in range(-90, 181)]
