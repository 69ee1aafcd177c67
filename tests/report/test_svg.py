"""The SVG of any plot is well formed, finite, inside its box, and keeps gaps and extremes."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from imucalib.report.document import Plot, Series
from imucalib.report.render.svg import Axis, linear_axis, render_svg
from worlds.report_strategies import PLOTS

NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?")
GEOMETRY = ("d", "x", "y", "width", "height", "viewBox", "transform")


def _elements(svg: str, tag: str) -> list[ET.Element]:
    return list(ET.fromstring(svg).iter("{http://www.w3.org/2000/svg}" + tag))


def _line(plot: Plot) -> str:
    """The path of the first line of the series, without legend and axes."""
    group = next(g for g in _elements(render_svg(plot), "g") if "--series-0" in g.get("style", ""))
    return str(group[0].get("d"))


def _points(path: str) -> np.ndarray:
    return np.array(re.findall(r"[ML](-?[\d.]+),(-?[\d.]+)", path), dtype=float)


def _plot(*series: Series, **options: bool) -> Plot:
    return Plot("title", "x", "y", series, **options)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(PLOTS)
def test_any_plot_is_well_formed_and_finite(plot: Plot) -> None:
    root = ET.fromstring(render_svg(plot))
    _, _, width, height = (float(v) for v in root.attrib["viewBox"].split())
    for element in root.iter():
        for name in GEOMETRY:
            value = element.get(name, "")
            assert not re.search("nan|inf", value, re.IGNORECASE)
            assert all(abs(float(v)) <= max(width, height) + 60 for v in NUMBER.findall(value))
    assert not any(key.endswith(("href", "src")) for e in root.iter() for key in e.attrib)


@settings(max_examples=300, deadline=None)
@given(st.floats(-1e9, 1e9), st.floats(-9, 9).map(lambda e: 10.0**e), st.integers(2, 9))
@example(-0.03125, 1e-6, 2)
def test_tick_labels_say_their_values(low: float, span: float, count: int) -> None:
    assume(span >= 1e-11 * abs(low))
    axis = linear_axis(low, low + span, count)
    assert max(2, int(count / 2.5)) <= len(axis.ticks) <= max(count + 1, 5)
    assert len(set(axis.labels)) == len(axis.labels)
    told = [_told(axis, label) for label in axis.labels]
    np.testing.assert_allclose(told, axis.ticks, atol=1e-6 * span + 1e-14 * abs(low), rtol=0)
    assert max(len(label) for label in axis.labels) <= 9


def _told(axis: Axis, label: str) -> float:
    """The value that a reader computes from a label and the note of its axis."""
    plain = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    note = re.fullmatch(r"(?:×10(\S+))?\s*(?:([+-]) (\S+))?", axis.note.translate(plain))
    assert note
    power = 10.0 ** int(note[1]) if note[1] else 1.0
    offset = float(f"{note[2]}{note[3]}") if note[3] else 0.0
    return float(label.translate(plain)) * power + offset


def test_gap_breaks_the_line_and_a_lone_point_stays_visible() -> None:
    y = np.array([1.0, 2.0, np.nan, 4.0, np.nan, 5.0, 6.0])
    path = _line(_plot(Series("a", np.arange(7.0), y, "line")))
    assert path.count("M") == 3
    assert path.count("L") == 2
    assert "h0" in path


def test_long_line_is_thinned_but_keeps_extremes_ends_and_gaps() -> None:
    n = 300_000
    y = np.random.default_rng(3).standard_normal(n)
    y[123_456], y[200_001] = 50.0, -40.0
    y[150_000:160_000] = np.nan
    plot = _plot(Series("a", np.arange(n) / 100, y, "line"))
    path = _line(plot)
    assert len(render_svg(plot)) < 60_000
    assert path.count("M") == 2
    short = _plot(
        Series("a", np.array([0.0, 1.0, n / 100 - 0.01]), np.array([0, 50.0, -40]), "line")
    )
    kept, whole = _points(path), _points(_line(short))
    np.testing.assert_allclose(kept.min(axis=0), whole.min(axis=0), atol=0.11)
    np.testing.assert_allclose(kept.max(axis=0), whole.max(axis=0), atol=0.11)


def test_equal_scales_keep_a_circle_round() -> None:
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = Series("a", 7 + 3 * np.cos(angle), 3 * np.sin(angle), "line")
    width, height = np.ptp(_points(_line(_plot(circle, equal=True))), axis=0)
    assert width == pytest.approx(height, abs=0.3)
    width, height = np.ptp(_points(_line(_plot(circle))), axis=0)
    assert width > 1.5 * height


def test_log_axis_drops_what_it_cannot_show_and_keeps_error_bars() -> None:
    y = np.array([0.01, -1.0, 0.0, 10.0])
    path = _line(_plot(Series("a", np.arange(4.0), y, "line"), log_y=True))
    assert path.count("M") == 2
    bars = Series("a", np.arange(4.0), y, "points", y - 0.02, y + 0.02)
    assert _line(_plot(bars, log_y=True)).count("V") == 4


def test_texts_are_escaped_and_points_have_hover_names() -> None:
    name = '<script>"&\x00\x1b'
    series = Series(name, np.arange(2.0), np.array([1.0, 2.0]), "points", names=(name, "b"))
    plot = Plot(name, name, name, (series, replace(series, mark="bars")), name)
    svg = render_svg(plot)
    assert "<script" not in svg
    titles = [e.text for e in _elements(svg, "title")]
    assert titles == ['<script>"&\ufffd\ufffd: 1', "b: 2"] * 2
