"""Hypothesis strategies: plots and documents of any numbers and any text."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from imucalib.report.render.document import Document, Facts, Plot, Section, Series, Table, Text

TONES = st.sampled_from(["ok", "warning", "bad", "plain"])
WORDS = st.text(max_size=60)
VALUES = st.one_of(
    st.floats(width=64),
    st.floats(-100, 100),
    st.integers(-3, 30).map(float),
    st.sampled_from([np.nan, 0.0, 1e-300, 1e308, 9.81]),
)


@st.composite
def series(draw: st.DrawFn) -> Series:
    n = draw(st.integers(0, 12))
    columns = [
        np.array(draw(st.lists(VALUES, min_size=n, max_size=n)), dtype=float) for _ in range(4)
    ]
    x, y, low, high = columns
    edges = draw(st.booleans())
    return Series(
        label=draw(WORDS),
        x=np.sort(x) if draw(st.booleans()) else x,
        y=y,
        mark=draw(st.sampled_from(["line", "points", "rings", "band", "net"])),
        low=low if edges else None,
        high=high if edges else None,
        names=tuple(draw(st.lists(WORDS, min_size=n, max_size=n))) if draw(st.booleans()) else (),
    )


PLOTS = st.builds(
    Plot,
    title=WORDS,
    x_label=WORDS,
    y_label=WORDS,
    series=st.lists(series(), max_size=3).map(tuple),
    caption=WORDS,
    equal=st.booleans(),
    log_y=st.booleans(),
)


@st.composite
def tables(draw: st.DrawFn) -> Table:
    columns, rows = draw(st.integers(1, 8)), draw(st.integers(0, 4))
    cell = st.one_of(WORDS, st.floats(-1e4, 1e4).map(lambda v: f"{v:.3f}"))
    return Table(
        draw(WORDS),
        tuple(draw(st.lists(WORDS, min_size=columns, max_size=columns))),
        tuple(tuple(draw(st.lists(cell, min_size=columns, max_size=columns))) for _ in range(rows)),
        draw(st.text("lr", min_size=columns, max_size=columns)),
        draw(WORDS),
        draw(st.dictionaries(st.integers(0, 4), TONES, max_size=2)),
    )


PAIRS = st.lists(st.tuples(WORDS, WORDS), max_size=3).map(tuple)
TEXTS = st.builds(Text, WORDS, TONES)
BLOCKS = st.one_of(TEXTS, st.builds(Facts, PAIRS), tables(), PLOTS)
DOCUMENTS = st.builds(
    Document,
    title=WORDS,
    verdict=TEXTS,
    sections=st.lists(
        st.builds(Section, WORDS, st.lists(BLOCKS, max_size=3).map(tuple), st.booleans()),
        max_size=3,
    ).map(tuple),
    footer=PAIRS,
)
