"""Tables of positions as people make them in a spreadsheet, written by openpyxl."""

from __future__ import annotations

from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array

NAMES = ("inclination", "toolface", "x", "y", "z")


def positions() -> Array:
    """(12, 5) angles (deg) and readings (g)."""
    rng = np.random.default_rng(4)
    angles = np.array([[i, t] for i in (30.0, 60.0, 90.0) for t in (0.0, 90.0, 180.0, 270.0)])
    i, t = np.deg2rad(angles).T
    ideal = np.column_stack([-np.sin(i) * np.cos(t), np.sin(i) * np.sin(t), np.cos(i)])
    return np.column_stack([angles, np.round(ideal + rng.normal(scale=1e-3, size=(12, 3)), 5)])


ROWS = positions()
#: Sheet -> what writes it, and "right" or "refused".
SHEETS: dict[str, tuple[Callable[[Any], None], str]] = {}


def sheet(expected: str = "right") -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Register what fills the first sheet of a workbook."""

    def add(fill: Callable[[Any], None]) -> Callable[[Any], None]:
        SHEETS[fill.__name__] = fill, expected
        return fill

    return add


def table(page: Any, heading: tuple[str, ...] = NAMES, rows: Array = ROWS) -> None:
    page.append(heading)
    for row in rows.tolist():
        page.append(row)


@sheet()
def plain(page: Any) -> None:
    table(page)


@sheet()
def title_merged(page: Any) -> None:
    page.append(["Calibration of probe 7, 14 May"])
    page.merge_cells("A1:E1")
    table(page)


@sheet()
def title_and_facts(page: Any) -> None:
    for row in (["Operator", "NN"], ["Date", date(2024, 5, 14)], ["Temperature", 21.5], []):
        page.append(row)
    table(page)


@sheet()
def group_row(page: Any) -> None:
    page.append(["Reference", None, "Reading", None, None])
    page.merge_cells("A1:B1")
    page.merge_cells("C1:E1")
    table(page)


@sheet()
def units_row(page: Any) -> None:
    page.append(NAMES)
    page.append(["deg", "deg", "g", "g", "g"])
    for row in ROWS.tolist():
        page.append(row)


@sheet()
def shifted(page: Any) -> None:
    for r, row in enumerate([NAMES, *ROWS.tolist()], start=3):
        for c, cell in enumerate(row, start=1):
            page.cell(r, c, cell)


@sheet()
def footer_of_means(page: Any) -> None:
    table(page)
    page.append([])
    page.append(["mean", None, *ROWS[:, 2:].mean(axis=0).tolist()])


@sheet()
def numbers_as_text(page: Any) -> None:
    page.append(NAMES)
    for row in ROWS.tolist():
        page.append([repr(cell) for cell in row])


@sheet()
def numbers_with_commas(page: Any) -> None:
    page.append(NAMES)
    for row in ROWS.tolist():
        page.append([repr(cell).replace(".", ",") for cell in row])


@sheet()
def degree_signs(page: Any) -> None:
    page.append(NAMES)
    for i, t, *reading in ROWS.tolist():
        page.append([f"{i:g}°", f"{t:g}°", *reading])


@sheet()
def a_column_of_notes(page: Any) -> None:
    page.append([*NAMES, "note"])
    for k, row in enumerate(ROWS.tolist()):
        page.append([*row, "again" if k == 3 else None])


@sheet("refused")
def formulas_that_were_never_computed(page: Any) -> None:
    page.append(NAMES)
    for k, row in enumerate(ROWS.tolist(), start=2):
        page.append([*row[:4], f"=SQRT(1-C{k}^2-D{k}^2)"])


@sheet("refused")
def no_heading(page: Any) -> None:
    for row in ROWS.tolist():
        page.append(row)


def written(fill: Callable[[Any], None], folder: Path) -> Path:
    """A workbook whose first sheet is filled."""
    import openpyxl

    book = openpyxl.Workbook()
    fill(book.active)
    book.create_sheet("other").append(["not", "this"])
    book.save(folder / "a.xlsx")
    return folder / "a.xlsx"
