"""Position tables: every dialect that is promised, and every mistake named by row and column."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from imucalib.arrays import Array
from imucalib.calibrators.lab.bench import in_celsius, observations_of, raw_unit
from imucalib.calibrators.lab.files import LabFiles, positions_in
from imucalib.calibrators.lab.position_table import ROLES, PositionTable, read_position_table
from imucalib.calibrators.lab.request import LabRequest
from imucalib.core.references import unit_vector
from imucalib.errors import ImucalError, UnreadableInput, UsageError
from imucalib.recording.mapping import FieldMapping

#: inclination, tool-face (deg), x, y, z (1e-6 g)
SHEET = np.array([
    [0.0, 0.0, -11718.0, 966306.0, 31738.0], [10.0, 0.0, -14648.0, 938278.4, 209862.4],
    [50.0, 120.0, -31151.4, -583006.0, 778122.8], [-60.0, 240.5, 1037109.0, 440330.4, -874997.0],
    [90.0, 0.0, -40000.5, 31000.25, 1009000.0],
])  # fmt: skip
HEADING = ["inclination", "tool_face", "x", "y", "z"]


def _joined(rows: list[list[str]], mark: str) -> str:
    return "".join(mark.join(row) + "\n" for row in rows)


def _cells(write: Callable[[float], str] = "{:.2f}".format) -> list[list[str]]:
    return [[write(v) for v in row] for row in SHEET.tolist()]


def _german(value: float) -> str:
    return f"{value:,.2f}".translate(str.maketrans(",.", ".,"))


FORMS: dict[str, str] = {
    "Markdown": "| incl | tf | ax | ay | az |\n|---|---|:--|--:|---|\n"
    + "".join(f"| {' | '.join(row)} |\n" for row in _cells()),
    "tabs": "incl\ttf\t$\\hat{a}_x$\t$\\hat{a}_y$\t$\\hat{a}_z$\n" + _joined(_cells(), "\t"),
    "blanks": "incl tf $a_{x}$ $a_{y}$ $a_{z}$\n" + _joined(_cells(), " "),
    "columns of blanks": "tool face   inclination   a x   a y   a z\n"
    + _joined([[row[1], row[0], *row[2:]] for row in _cells()], "    "),
    "thousands": "incl,tf,x,y,z\n" + _joined(_cells('"{:,.2f}"'.format), ","),
    "thousands in German": "Neigung;Werkzeugwinkel;X;Y;Z\n" + _joined(_cells(_german), ";"),
    "narrow blanks": "incl;tf;x;y;z\n"
    + _joined(_cells(lambda v: f"{v:,.2f}".replace(",", "\u202f")), ";"),
    "German": "Neigung [Grad];Werkzeugwinkel [Grad];Beschleunigung X;Beschleunigung Y;"
    "Beschleunigung Z\n" + _joined(_cells(lambda v: f"{v:.2f}".replace(".", ",")), ";"),
    "MWD": "Station,INC,HSTF,Gx,Gy,Gz,Bx,By,Bz\n"
    + _joined([[str(k), *row, "0.1", "0.2", "0.3"] for k, row in enumerate(_cells())], ","),
    "footer": "Sheet,,,,\n,,,,\n" + ",".join(HEADING) + "\n" + _joined(_cells(), ",")
    + ",,,,\nMean,,1.0,2.0,3.0\nSigned: me,,,,\n",
    "empty lines": ",".join(HEADING) + "\n" + _joined(_cells(), ",").replace("\n", "\n,,,,\n\n", 2),
    "rad": "inclination (rad),tool_face [rad],x,y,z\n"
    + _joined([[*(f"{np.radians(float(c)):.9f}" for c in r[:2]), *r[2:]] for r in _cells()], ","),
    "units that differ": "inclination,tool_face,x_ug,y_mg,z_g\n"
    + _joined([[*r[:3], str(float(r[3]) / 1e3), str(float(r[4]) / 1e6)] for r in _cells()], ","),
    "no label on a column": ",inclination,tool_face,x,y,z,\n"
    + _joined([["a", *row, ""] for row in _cells()], ","),
    "mangled degree": "inclination,tool_face,x,y,z,Temp. (?C)\n"
    + _joined([[*row, "21.5"] for row in _cells()], ","),
    "a column that cannot be read": "inclination,tool_face,x,y,z,temperature\n"
    + _joined([[*row, "warm"] for row in _cells()], ","),
}  # fmt: skip


def read(path: Path, text: str, **options: object) -> PositionTable:
    path.write_text(text, encoding="utf-8")
    return read_position_table(path, **options)  # type: ignore[arg-type]


def in_degrees(table: PositionTable, role: str) -> np.ndarray:
    values = table.columns[role]
    return np.degrees(values) if table.unit.get(role) == "rad" else values


@pytest.mark.parametrize("form", FORMS)
def test_a_sheet_typed_in_another_way_is_the_same(form: str, tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    table = read(path, FORMS[form])
    if form == "units that differ":
        found = positions_in(LabFiles(path))
        assert found is not None
        size = {"ug": 1.0, "mg": 1e3, "g": 1e6}
        raw = found.raw() * [size[found.unit[a]] for a in "xyz"]
    else:
        raw = table.raw()
    np.testing.assert_allclose(raw, SHEET[:, 2:], rtol=1e-9)
    np.testing.assert_allclose(in_degrees(table, "inclination"), SHEET[:, 0], atol=1e-6)
    np.testing.assert_allclose(in_degrees(table, "tool_face"), SHEET[:, 1], atol=1e-6)
    assert table.row.tolist() == [1, 2, 3, 4, 5]


def test_a_number_with_one_mark_is_not_guessed(tmp_path: Path) -> None:
    text = "inclination,tool_face,x,y,z\n" + '0,0,"1,000","2,000","3,000"\n' * 2
    with pytest.raises(UnreadableInput, match=r"row 1, column x: '1,000' is not a number; 6 in"):
        read(tmp_path / "a.csv", text)
    for mark, size in ((".", 1000.0), (",", 1.0)):
        table = read(tmp_path / "a.csv", text, mapping=FieldMapping(decimal=mark))
        np.testing.assert_allclose(table.raw()[0], size * np.arange(1.0, 4.0))


BROKEN = "inclination,tool_face,x,y,z,remark\n" + "".join(
    f"{10 * k},0,{0.1 * k:.1f},{'' if k in (3, 7) else 1},{'x' if k == 7 else 2},\n"
    for k in range(1, 21)
)


def test_all_bad_rows_are_listed_and_can_be_excluded(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with pytest.raises(UnreadableInput, match=r"row 3, column y: the cell is empty; 3 in all: also "
                       r"row 7, column y, row 7, column z.*--exclude 3,7"):  # fmt: skip
        read(path, BROKEN)
    table = read(path, BROKEN, exclude=(3, 7, 9))
    assert table.row.tolist() == [k for k in range(1, 21) if k not in (3, 7)]
    assert any("excluded as asked, and not readable: row 3, 7" in note for note in table.left_out)
    ragged = BROKEN.replace("\n70,0,", "\n70,0,0,")
    assert read(path, ragged, exclude=(3, 7)).row.tolist() == table.row.tolist()
    with pytest.raises(UnreadableInput, match=r"7 cells where the heading has 6"):
        read(path, ragged, exclude=(3,))
    many = "inclination,tool_face,x,y,z\n" + "0,0,,1,2\n" * 25
    with pytest.raises(UnreadableInput, match=r"25 in all: also row 2, .*column x and 15 more"):
        read(path, many)
    with pytest.raises(UsageError, match="row 3 takes no part"):
        table.demand(3, "--swap")


@pytest.mark.parametrize("zero", ["horizontal", "vertical"])
def test_a_blank_tool_face_at_the_vertical_is_none(zero: str, tmp_path: Path) -> None:
    heading = f"inclination (deg from {zero}),tool_face,x,y,z\n"
    upright, level = (90, 30) if zero == "horizontal" else (180, 30)
    rows = f"{upright},,0.01,0.02,1.01\n{level},40,0.5,0.5,0.5\n"
    table = read(tmp_path / "a.csv", heading + rows)
    assert table.upright == (1,)
    assert any("blank at the vertical" in note for note in table.left_out)
    with pytest.raises(UnreadableInput, match="row 2, column tool_face: the cell is empty"):
        read(tmp_path / "a.csv", heading + rows.replace(",40,", ",,"))


ROWS = [(10.5, 90.0, 0.1, 0.97, 0.18), (-45.0, 180.25, -0.7, 0.02, -0.7), (0.0, 0.0, 0.0, 1, 0.0)]


def workbook(path: Path) -> Path:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    for row in [("Bench 7",), (), ("Inclination", "Tool-face", "Gx", "Gy", "Gz"),
                ("deg", "deg", "g", "g", "g"), *ROWS]:  # fmt: skip
        sheet.append(row)
    book.save(path)
    return path


def test_a_spreadsheet_is_a_table(tmp_path: Path) -> None:
    table = read_position_table(workbook(tmp_path / "t.xlsx"))
    np.testing.assert_array_equal(table.raw(), np.array(ROWS)[:, 2:])
    assert table.unit["x"] == "g"


@pytest.mark.parametrize(
    ("heading", "of"),
    [
        ("temperature_K", lambda c: c + 273.15),
        ("Temperature (°F)", lambda c: 1.8 * c + 32.0),
        ("temp_degF", lambda c: 1.8 * c + 32.0),
        ("Temp [°C]", lambda c: c),
        ("temperature", lambda c: c),
    ],
)
def test_a_temperature_is_read_in_the_unit_of_its_heading(
    heading: str, of: Callable[[Array], Array], tmp_path: Path
) -> None:
    celsius = np.linspace(18.0, 31.0, 12)
    path = _warm_sheet(tmp_path / "t.csv", heading, of(celsius))
    table = in_celsius(read_position_table(path))
    context = observations_of(table, raw_unit(table, None, None), LabRequest()).context
    np.testing.assert_allclose(context["temperature"], celsius, atol=1e-3)
    guess = ("temperature: no unit is stated, taken as degC",)
    assert table.notes == (guess if heading == "temperature" else ())


def test_a_temperature_that_celsius_cannot_be_is_no_guess(tmp_path: Path) -> None:
    path = _warm_sheet(tmp_path / "t.csv", "temperature", np.linspace(291.0, 304.0, 12))
    table = read_position_table(path)
    with pytest.raises(UsageError, match="no unit is stated") as refused:
        in_celsius(table)
    assert "temperature_K" in refused.value.remedy


def _warm_sheet(path: Path, heading: str, warm: Array) -> Path:
    i, t = np.repeat([0.0, 30.0, 60.0], 4), np.tile([0.0, 90.0, 180.0, 270.0], 3)
    force = unit_vector(np.deg2rad(i), np.deg2rad(t))
    rows = np.column_stack([i, t, 1000.0 * force, warm])
    head = f"inclination,tool_face,x_mg,y_mg,z_mg,{heading}"
    np.savetxt(path, rows, "%.6f", ",", header=head, comments="", encoding="utf-8")
    return path


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


ABOVE = {
    "a title with two commas": "Protocol, tool 4711, bench 2\n",
    "a title and a blank line": "Protocol, tool 4711, bench 2\n\n",
    "a title of all cells": "Protocol, tool 4711, bench 2;;;;;\n",
    "a group": ";;;Sensor A;;\n",
    "a title and a group": "Protocol, tool 4711;;;;;\nOperator: NN;;;Sensor A (primary);;\n",
    "keys and values": "Tool;4711\nOperator;NN\nDate;02.03.2026\ng;9,8123\n\n",
}
NUMBERED = """No;INC;HSTF;Gx;Gy;Gz
;deg;deg;g;g;g
1;0,0;0,0;0,0118;-0,0053;1,0171
2;0,0;90,0;0,0125;-0,0053;1,0172
3;10,0;0,0;-0,1619;-0,0048;1,0012
4;10,0;90,0;0,0127;0,1666;1,0027
"""


@pytest.mark.parametrize("above", ABOVE.values(), ids=ABOVE)
@pytest.mark.parametrize("units", [True, False])
def test_a_table_is_read_from_its_numbers_upwards(units: bool, above: str, tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    lines = NUMBERED.splitlines(keepends=True)
    path.write_text(above + "".join(lines if units else [lines[0], *lines[2:]]))
    table = read_position_table(path)
    np.testing.assert_array_equal(table.columns["inclination"], [0.0, 0.0, 10.0, 10.0])
    np.testing.assert_array_equal(table.raw()[2], [-0.1619, -0.0048, 1.0012])
    assert table.unit.get("x", "") == ("g" if units else "")


@pytest.mark.parametrize("heading", [
    "Operator: NN;;;Sensor A;;;Sensor B;;\nNo;INC;HSTF;Gx;Gy;Gz;Gx;Gy;Gz\n",
    "No;INC;HSTF;Gx A;Gy A;Gz A;Gx B;Gy B;Gz B\n",
])  # fmt: skip
def test_of_two_sensors_the_names_are_told(heading: str, tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    rows = [f"{k};{10 * k},0;0,0;0,1;0,2;0,9{k};-0,1;0,3;0,9{k}\n" for k in range(6)]
    path.write_text(heading + "".join(rows))
    with pytest.raises(UsageError, match="2 sensors to choose from") as caught:
        read_position_table(path)
    option, sensor = caught.value.add
    found = read_position_table(path, mapping=FieldMapping(sensor=sensor))
    assert option == "--sensor"
    assert found.raw()[3].tolist() == [0.1, 0.2, 0.93]
