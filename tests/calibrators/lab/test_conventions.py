"""Angle conventions: in and out again, and on every page and table."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.arrays import Array
from imucalib.calibrators.lab.position_table import PositionTable, read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun, run_lab
from imucalib.core.angle_conventions import PRESETS, Conventions
from imucalib.core.references import unit_vector
from imucalib.report.lab import compose_lab_document
from imucalib.report.render.document import Document, Plot
from imucalib.units import DEG
from worlds.places import SAMPLES

conventions = st.builds(
    Conventions,
    gravity_sign=st.sampled_from(["down", "up"]),
    z_axis=st.sampled_from(["down-hole", "up-hole"]),
    inclination_zero=st.sampled_from(["horizontal", "vertical"]),
    toolface_zero_axis=st.sampled_from(["+x", "-x", "+y", "-y"]),
    toolface_sense=st.sampled_from(["clockwise", "counter-clockwise"]),
    toolface_offset=st.floats(-360.0, 360.0),
)


def _read(c: Conventions, inclination: float, tool_face: float) -> Any:
    """Reading over g of a tool at the table's angles in degrees."""
    return unit_vector(*c.inside(np.array(inclination), np.array(tool_face)))


@given(conventions, st.floats(-180.0, 180.0), st.floats(0.0, 360.0, exclude_max=True))
def test_in_and_out_again(c: Conventions, inclination: float, tool_face: float) -> None:
    i, t = c.outside(*c.inside(np.array([inclination]), np.array([tool_face])))
    assert i[0] == pytest.approx(inclination, abs=1e-10)
    assert abs(np.mod(t[0] - tool_face + 180.0, 360.0) - 180.0) < 1e-9


@given(conventions)
def test_the_zero_axis_reads_most_at_tool_face_zero(c: Conventions) -> None:
    level = 0.0 if c.inclination_zero == "horizontal" else 90.0
    reading = _read(c, level, -c.toolface_offset)
    axis = dict(zip("xyz", np.eye(3), strict=True))[c.toolface_zero_axis[1]]
    sign = 1.0 if c.toolface_zero_axis[0] == "+" else -1.0
    assert np.allclose(reading, sign * axis, atol=1e-12)


#: Inclination of the middle (deg), and inclination and tool-face of a reading: with the scribe line
#: on +y and z down, high side of gravity; z up the hole, high side of force; the paper's.
FORMULAE: dict[str, tuple[float, Callable[..., float], Callable[..., float]]] = {
    "drilling-gravity": (90.0, np.arctan2, lambda x, y: np.arctan2(-x, -y)),
    "drilling-force": (90.0, np.arctan2, lambda x, y: np.arctan2(-x, y)),
    "paper": (0.0, lambda xy, z: np.arctan2(z, xy), np.arctan2),
}


@pytest.mark.parametrize("name", FORMULAE)
@given(st.floats(-89.0, 89.0), st.floats(0.0, 359.9))
def test_a_preset_is_its_trades_formulae(name: str, away: float, tool_face: float) -> None:
    middle, of_inclination, of_tool_face = FORMULAE[name]
    x, y, z = _read(PRESETS[name], middle + away, tool_face)
    assert of_inclination(np.hypot(x, y), z) / DEG == pytest.approx(middle + away, abs=1e-9)
    found = of_tool_face(x, y) / DEG
    assert abs(np.mod(found - tool_face + 180.0, 360.0) - 180.0) < 1e-9


OTHERS = [
    *(meant for name, meant in PRESETS.items() if name != "paper"),
    Conventions(toolface_zero_axis="+x", toolface_offset=17.0),
    Conventions(inclination_zero="vertical", toolface_sense="counter-clockwise"),
]


def _as_meant(table: PositionTable, meant: Conventions) -> PositionTable:
    """The same positions under another convention's names."""
    inside = Conventions().inside(table.columns["inclination"], table.columns["tool_face"])
    shown = dict(zip(("inclination", "tool_face"), meant.outside(*inside), strict=True))
    return replace(table, columns={**table.columns, **shown})


@pytest.fixture(scope="module")
def paper_table() -> PositionTable:
    table = read_position_table(SAMPLES / "paper_table_1.csv")
    y = table.columns["y"].copy()
    y[9] *= -1.0
    return replace(table, columns={**table.columns, "y": y})


def _run(table: PositionTable, meant: Conventions) -> LabRun:
    request = LabRequest(gravity=9.8061, loop=False, conventions=meant)
    return run_lab(_as_meant(table, meant), request)


@pytest.fixture(scope="module")
def plain(paper_table: PositionTable) -> LabRun:
    return _run(paper_table, Conventions())


def _plots(document: Document) -> Iterator[Plot]:
    for section in document.sections:
        yield from (block for block in section.blocks if isinstance(block, Plot))


def _angles(values: Array, which: int, meant: Conventions) -> Array:
    """Angles of the paper's convention (deg) as another says them."""
    pair = [values * DEG, np.zeros_like(values)]
    shown = meant.outside(*(pair if which == 0 else pair[::-1]))[which]
    return np.mod(shown, 360.0) if which else shown


@pytest.mark.parametrize("meant", [OTHERS[-1], pytest.param(OTHERS[0], marks=pytest.mark.slow)])
def test_every_axis_of_angles_is_the_users(
    paper_table: PositionTable, plain: LabRun, meant: Conventions
) -> None:
    shown = _run(paper_table, meant)
    seen = 0
    for one, two in zip(
        _plots(compose_lab_document(plain)), _plots(compose_lab_document(shown)), strict=True
    ):
        assert (one.title, one.x_label, one.y_label) == (two.title, two.x_label, two.y_label)
        which = {"inclination (deg)": 0, "tool-face (deg)": 1}.get(one.x_label)
        error = re.search(r"error of (inclination|tool-face)", one.y_label)
        sense = meant.senses[error[1] == "tool-face"] if error else 1.0
        for a, b in zip(one.series, two.series, strict=True):
            if which is not None and a.mark != "band":
                seen += 1
                want = _angles(np.asarray(a.x), which, meant)
                assert np.allclose(np.sort(want), np.sort(np.asarray(b.x)), atol=1e-6)
            if a.mark == "points":
                scale = max(float(np.nanmax(np.abs(np.asarray(a.y)))), 1e-9)
                ys = sense * np.asarray(a.y), np.asarray(b.y)
                assert np.allclose(*ys, atol=1e-5 * scale, equal_nan=True)
    assert seen


@pytest.mark.parametrize("meant", [Conventions(), OTHERS[-1]])
def test_a_dial_is_off_by_what_its_user_would_read(meant: Conventions) -> None:
    """A dial that reads 0.9 + 1.2 I / 90 deg too little: the errors are in the dial's own angle."""
    rng = np.random.default_rng(5)
    grid = np.array([(i, t) for i in (-60, -30, 0, 30, 60, 89) for t in range(0, 360, 45)], float)
    dial = meant.outside(*(grid.T * DEG))
    off = 0.9 + 1.2 * dial[0] / 90.0
    truth = meant.inside(dial[0] + off, dial[1])
    reading = unit_vector(*truth) + 1e-3 * rng.normal(size=(len(grid), 3))
    columns = {"inclination": dial[0], "tool_face": dial[1]}
    columns |= {a: reading[:, k] for k, a in enumerate("xyz")}
    table = PositionTable(
        columns, {c: c for c in columns}, {a: "g" for a in "xyz"}, np.arange(1, len(grid) + 1),
        path="bench.csv", sha256="",
    )  # fmt: skip
    declare = ("inclination_zero", "inclination_scale")
    run = run_lab(table, LabRequest(conventions=meant, loop=False, declare=declare))
    found = {p.name: p for p in run.calibration.parameters}
    for name, want in (("inclination_zero", 0.9), ("inclination_scale", 1.2)):
        assert abs(found[name].value - want) < 4.0 * found[name].sd + 0.01
    for row in run.details.fixture.inclination:
        want = 0.9 + 1.2 * row.inclination_deg / 90.0
        assert abs(row.true_minus_dial_deg - want) < 4.0 * row.sd_deg + 0.01
