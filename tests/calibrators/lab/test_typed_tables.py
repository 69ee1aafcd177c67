"""A sheet typed in another way is the same sheet, or is refused with what and where."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from imucalib.calibrators.lab.files import LabFiles, positions_in
from imucalib.calibrators.lab.position_table import PositionTable, read_position_table
from imucalib.errors import UnreadableInput, UsageError
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


def lines(table: np.ndarray) -> list[str]:
    return [",".join(map(repr, row)) for row in table.tolist()]


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
