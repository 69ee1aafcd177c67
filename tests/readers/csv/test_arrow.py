"""pyarrow, where it is installed, changes no number, no stamp, no message of the CSV reader."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib.errors import ImucalError
from imucalib.readers import read
from imucalib.readers.csv import rows as csv_rows
from imucalib.readers.csv.rows import Layout, Rows, parse
from imucalib.readers.csv.text import Lines
from imucalib.recording.mapping import FieldMapping

ODD = (
    "", "nan", "NaN", "inf", "-Infinity", "1e400", "4.9e-324", "+4", ".5", "5.", " 3", "3 ", "-0",
    "0x10", "1_0", "1d3", "NA", "null", "1,5", "1\0", "--1", "-", "1e", "true", "\u0661", "007",
    "9007199254740993", "9223372036854775808", "1.7976931348623159e308", "\t7", "#", "'1'", "1.0",
    "2.2250738585072011e-308", "2024-01-02 03:04:05.678",
)  # fmt: skip
doubles = st.integers(0, 2**64 - 1).map(lambda n: repr(struct.unpack("d", struct.pack("Q", n))[0]))
decimals = st.decimals(allow_nan=False, allow_infinity=False, places=7).map(str)
cells = st.one_of(
    doubles, decimals, st.integers(-(2**63), 2**63 - 1).map(str), st.sampled_from(ODD)
)
stamps = st.one_of(st.integers(0, 2**62).map(str), decimals, st.sampled_from(ODD))


def outcome(text: bytes, layout: Layout, arrow: bool) -> Rows | str:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(csv_rows, "arrow_is_installed", lambda: arrow)
        try:
            return parse(Lines(text, 1), layout, "file")
        except ImucalError as error:
            return str(error)


def assert_same(text: bytes, layout: Layout) -> None:
    one, two = outcome(text, layout, True), outcome(text, layout, False)
    if isinstance(one, str) or isinstance(two, str):
        assert one == two
        return
    assert one.values.tobytes() == two.values.tobytes() or np.array_equal(
        one.values, two.values, equal_nan=True
    )
    if one.stamps.dtype.kind == "S":
        assert one.stamps.tolist() == two.stamps.tolist()
        return
    assert one.stamps.dtype == two.stamps.dtype
    assert np.array_equal(one.stamps, two.stamps, equal_nan=one.stamps.dtype.kind == "f")


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(
    table=st.lists(st.tuples(stamps, cells, cells, cells), min_size=1, max_size=6),
    kind=st.sampled_from(("int", "float", "text", "")),
    delimiter=st.sampled_from((",", ";", "\t")),
)
def test_same_rows_or_same_message(table: list[tuple[str, ...]], kind: str, delimiter: str) -> None:
    text = "".join(delimiter.join(row) + "\n" for row in table).encode()
    time = (0,) if kind else ()
    assert_same(text, Layout(delimiter, ".", 4, time, kind, (1, 3)))


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(rows=st.lists(st.tuples(decimals, doubles, decimals), min_size=1, max_size=20))
def test_plain_numbers_are_read_by_pyarrow(rows: list[tuple[str, ...]]) -> None:
    text = "".join(",".join(row) + "\n" for row in rows).encode()
    found = csv_rows.columns_of(text, ",", 3, ((0,), "float"), (1, 2))
    assert found is not None
    assert found[0][0].tolist() == [float(row[0]) for row in rows]
    assert np.array_equal(
        found[1], [[float(row[1]), float(row[2])] for row in rows], equal_nan=True
    )


@pytest.mark.parametrize("stamp", ["{k}", "{s:.2f}", "2024-05-06 07:08:09.{ms:03d}"])
def test_whole_files_are_equal(tmp_path: Path, stamp: str) -> None:
    rng = np.random.default_rng(2)
    lines = ["time,x,y,z"]
    for k in range(900):
        x, y, z = rng.normal((0.1, 0.2, 0.97), 0.01)
        time = stamp.format(k=1_700_000_000_000 + 10 * k, s=0.01 * k, ms=k)
        lines.append(f"{time},{x:.6f},{y:.6f},{z:.6f}" if k != 400 else f"{time},,,")
    path = tmp_path / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    found = []
    for arrow in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(csv_rows, "arrow_is_installed", lambda arrow=arrow: arrow)
            found.append(read(path, FieldMapping(acc_unit="g")))
    one, two = found
    assert one.notes == two.notes
    assert one.gaps == two.gaps
    assert one.start_ns == two.start_ns
    for name, channel in one.channels.items():
        assert np.array_equal(channel.t, two.channels[name].t)
        assert np.array_equal(channel.values, two.channels[name].values)
