"""Position tables: every dialect that is promised, and every mistake named by row and column."""

from __future__ import annotations

import gzip
import hashlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib.calibrators.lab.position_table import ROLES, PositionTable, read_position_table
from imucalib.errors import ImucalError, UnreadableInput, UsageError

PLAIN = "inclination,tool_face,x,y,z\n0,0,-11.5,966.25,31\n10,90,938,-14,209.5\n"


def _write(folder: Path, text: str | bytes, name: str = "table.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def _refused(path: Path, kind: type[ImucalError] = UnreadableInput) -> ImucalError:
    with pytest.raises(kind) as caught:
        read_position_table(path)
    assert str(path) in caught.value.where
    return caught.value


@pytest.mark.parametrize("role", sorted(ROLES))
def test_every_synonym_of_a_heading(tmp_path: Path, role: str) -> None:
    for heading in ROLES[role]:
        for shown in (heading, heading.upper(), f" {heading} "):
            kept = ["inclination", "tool_face", "x", "y", "z"]
            names = [shown if name == role else name for name in kept]
            if role not in kept:
                names.append(shown)
            text = ",".join(names) + "\n" + ",".join("12345678"[: len(names)]) + "\n"
            table = read_position_table(_write(tmp_path, text))
            first = 0.0 if role == "session" else names.index(shown) + 1.0  # counted from 0
            assert table.columns[role][0] == first
            assert role not in table.unit


def test_columns_can_be_named(tmp_path: Path) -> None:
    path = _write(tmp_path, PLAIN.replace("inclination", "dial A").replace("tool_face", "dial B"))
    assert "no column for inclination, tool_face" in _refused(path).what
    chosen = {"inclination": "dial A", "tool_face": "dial B"}
    assert np.array_equal(read_position_table(path, chosen).columns["inclination"], [0.0, 10.0])
    for bad, words in (({"incl": "dial A"}, "unknown column role"),
                       ({"inclination": "dial C"}, "no column is called 'dial C'")):  # fmt: skip
        with pytest.raises(UsageError, match=words) as caught:
            read_position_table(path, bad)
        assert caught.value.remedy


@pytest.mark.parametrize(
    ("text", "what", "where"),
    [
        ("", "file is empty", ""),
        ("\n\n# only notes\n", "no rows", ""),
        ("inclination,tool_face,x,y,z\n", "heading but no rows", ""),
        ("1,2,3,4,5\n6,7,8,9,10\n", "numbers, not headings", "line 1"),
        (PLAIN.replace("x,y", "x,x"), "same heading", "line 1"),
        (PLAIN.replace("10,90,", "10,90,7,"), "6 cells where the heading has 5", "row 2"),
        (PLAIN.replace("10,90,", "10,"), "4 cells where the heading has 5", "row 2"),
        (PLAIN.replace("209.5", "2o9.5"), "'2o9.5' is not a number", "row 2, column z"),
        (PLAIN.replace("966.25", ""), "cell is empty", "row 1, column y"),
        (PLAIN.replace("966.25", "nan"), "'nan' is not a number", "row 1, column y"),
        (PLAIN.replace("\n10,", "\ninf,"), "'inf' is not a number", "row 2, column inclination"),
        (PLAIN.replace("y,z", "b,c"), "no column for y, z", ""),
    ],
)
def test_mistakes_are_named_where_they_are(
    tmp_path: Path, text: str, what: str, where: str
) -> None:
    error = _refused(_write(tmp_path, text))
    assert what in error.what
    assert error.where.endswith(where)


def test_packed_and_utf_16_tables(tmp_path: Path) -> None:
    packed = _write(tmp_path, gzip.compress(PLAIN.encode()), "table.csv.gz")
    assert np.array_equal(read_position_table(packed).raw()[1], [938.0, -14.0, 209.5])
    assert read_position_table(packed).sha256 == hashlib.sha256(packed.read_bytes()).hexdigest()
    wide = _write(tmp_path, PLAIN.replace(",", "\t").encode("utf-16"), "table.txt")
    assert np.array_equal(read_position_table(wide).raw()[1], [938.0, -14.0, 209.5])


@pytest.mark.parametrize("title", ["", "Bench of March\n", "Bench of March,,,,\n\n,,,,\n"])
@pytest.mark.parametrize("units", ["", "deg,deg,mg,mg,mg\n", "[°],[°],[mg],[mg],[mg]\n"])
def test_a_table_as_a_spreadsheet_writes_it(title: str, units: str, tmp_path: Path) -> None:
    heading, rows = PLAIN.split("\n", 1)
    if "°" in units:
        heading = heading.replace("tool_face", "tool_face (deg)")
    text = f"{title}{heading}\n{units}{rows}"
    table = read_position_table(_write(tmp_path, text.encode("cp1252")))
    np.testing.assert_array_equal(table.raw()[1], [938.0, -14.0, 209.5])
    assert table.row.tolist() == [1, 2]
    if units:
        assert table.unit["x"] == "mg"


FACED = "face,x,y,z\n+x,1,0,0\nY-,0,-1,0\n\u2212z,0,0,-1\n"


def test_faces_are_directions(tmp_path: Path) -> None:
    table = read_position_table(_write(tmp_path, FACED), need_angles=False, need_direction=True)
    found = np.stack([table.columns[u] for u in ("ux", "uy", "uz")], axis=-1)
    assert np.array_equal(found, [[1, 0, 0], [0, -1, 0], [0, 0, -1]])
    assert table.names["face"] == "face"
    path = _hdf5(tmp_path, face=[b"+x", b"-z"], raw=[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    table = read_position_table(path, need_angles=False, need_direction=True)
    assert np.array_equal(table.columns["uz"], [0.0, -1.0])


@pytest.mark.parametrize(
    ("text", "what", "where", "remedy"),
    [
        (FACED.replace("Y-", "left"), "'left' is no face", "row 2, column face", "write +x, -x"),
        (FACED.replace("Y-", "y"), "'y' is no face", "row 2, column face", "ux, uy, uz"),
        (FACED.replace("Y-", ""), "cell is empty", "row 2, column face", "write +x, -x"),
        (FACED.replace("face", "side"), "no column for ux, uy, uz", "", "--columns face=B"),
        (FACED.replace("\n", ",1\n").replace("z,1\n", "z,up\n", 1), "several columns", "", "face="),
        (FACED.replace("\n", ",1\n").replace("z,1\n", "z,ux\n", 1), "several columns", "", "face="),
    ],
)
def test_wrong_faces_are_named_with_their_row(
    tmp_path: Path, text: str, what: str, where: str, remedy: str
) -> None:
    with pytest.raises(UnreadableInput) as caught:
        read_position_table(_write(tmp_path, text), need_angles=False, need_direction=True)
    assert what in caught.value.what
    assert caught.value.where.endswith(where)
    assert remedy in caught.value.remedy


def _hdf5(folder: Path, **datasets: object) -> Path:
    path = folder / "table.h5"
    with h5py.File(path, "w") as file:
        for name, values in datasets.items():
            file[name.replace("__", "/")] = values
    return path


def test_hdf5_columns(tmp_path: Path) -> None:
    path = _hdf5(tmp_path, bench__inclination=[0.0, 10.0], bench__tool_face=[0, 90], x=[1.0, 2.0],
                 y=[3.0, 4.0], z=[5.5, 0.1])  # fmt: skip
    table = read_position_table(path)
    assert np.array_equal(table.raw(), [[1.0, 3.0, 5.5], [2.0, 4.0, 0.1]])
    assert np.array_equal(table.columns["tool_face"], [0.0, 90.0])


def test_hdf5_matrix_and_table(tmp_path: Path) -> None:
    raw = np.random.default_rng(1).standard_normal((3, 3))
    path = _hdf5(tmp_path, inclination=[0.0, 1.0, 2.0], tool_face=[3.0, 4.0, 5.0], raw=raw)
    assert np.array_equal(read_position_table(path).raw(), raw)
    fields = [(name, "f8") for name in ("inclination", "tool_face", "x", "y", "z")]
    rows = np.array([(1.0, 2.0, 3.0, 4.0, 5.0)], dtype=fields)
    assert np.array_equal(read_position_table(_hdf5(tmp_path, rows=rows)).raw(), [[3.0, 4.0, 5.0]])


def test_hdf5_mistakes(tmp_path: Path) -> None:
    path = _hdf5(tmp_path, inclination=[0.0, 1.0], tool_face=[0.0], x=[1.0], y=[1.0], z=[1.0])
    assert "different length" in _refused(path).what
    path = _hdf5(tmp_path, inclination=[0.0, np.nan], tool_face=[0.0, 1.0], raw=np.ones((2, 3)))
    assert _refused(path).where.endswith("row 2, column inclination")
    broken = _write(tmp_path, path.read_bytes()[:200], "broken.h5")
    assert "HDF5" in _refused(broken).what
    assert "no column" in _refused(_hdf5(tmp_path, note=[1.0, 2.0])).what


def test_every_truncation_is_a_table_or_a_clear_refusal(tmp_path: Path) -> None:
    found: list[PositionTable | str] = []
    for size in range(len(PLAIN)):
        try:
            found.append(read_position_table(_write(tmp_path, PLAIN[:size])))
        except UnreadableInput as error:
            found.append(error.where)
    refused = [where for where in found if isinstance(where, str)]
    assert all("table.csv" in where for where in refused)
    # A row that is cut off before its last cell is refused: all but three cuts before there.
    assert len(refused) == PLAIN.rindex(",") + 2 - len("\n31")


@given(
    st.lists(
        st.lists(
            st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=5, max_size=5
        ),
        min_size=1,
        max_size=6,
    )
)
def test_numbers_come_back_bit_by_bit(rows: list[list[float]]) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        text = "inclination,tool_face,x,y,z\n"
        text += "".join(",".join(map(repr, row)) + "\n" for row in rows)
        table = read_position_table(_write(Path(folder), text))
    roles = ("inclination", "tool_face", "x", "y", "z")
    assert np.array_equal(np.stack([table.columns[r] for r in roles], axis=-1), np.array(rows))


@pytest.mark.parametrize(
    ("heading", "rows", "positions"),
    [
        ("x,y,z", "0,0,1\n0,1,0\n1,0,0\n", True),
        ("time_s,x_g,y_g,z_g", "0,0,0,1\n30,0,1,0\n55,1,0,0\n", True),
        ("time,x,y,z", "0,0,0,1\n0.02,0,0.001,1\n0.04,0.001,0,1\n0.06,0,0,1\n", False),
        ("time,x,y,z", "0,0,0,1\n20,0,0.001,1\n40,0.001,0,1\n60,0,0,1\n", False),  # ms, perhaps
        ("time_s,x,y,z", "0,0,0,1\n20,0,0.001,1\n40,0.001,0,1\n60,0,0,1\n", True),  # one rest again
    ],
)
def test_still_positions_are_not_the_samples_of_a_recording(
    heading: str, rows: str, positions: bool, tmp_path: Path
) -> None:
    table = read_position_table(_write(tmp_path, f"{heading}\n{rows}"), need_angles=False)
    assert table.of_positions == positions
