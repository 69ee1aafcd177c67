"""Files that other libraries wrote, with planted truth: none is read wrongly without a word."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.arrays import Array
from imucalib.errors import ImucalError
from imucalib.readers.csv.table import Cells, table_cells
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording
from worlds import dialects_messages, dialects_netcdf, dialects_pandas  # noqa: F401  (register)
from worlds.dialects import DIALECTS, RATE, START, Dialect, N, T
from worlds.dialects_xlsx import NAMES, ROWS, SHEETS, written

NEEDS = {"protobuf": ["google.protobuf"], "tables": ["tables", "pandas"]}


def wrong_in(found: Recording, planted: Dialect) -> list[str]:
    """What differs from what was planted, a sentence each."""
    said, kept = list[str](), np.ones(N, dtype=bool) if planted.kept is None else planted.kept
    for quantity, sensors in (("acceleration", planted.force), ("angular_rate", planted.turn)):
        names = {n for n, c in found.channels.items() if c.quantity == quantity}
        if names != {f"{sensor}/{quantity}" for sensor in sensors}:
            said.append(f"{quantity} of {sorted(names)}")
            continue
        for sensor, values in sensors.items():
            channel = found.channels[f"{sensor}/{quantity}"]
            said += differences(channel.t, channel.values, values[kept], T[kept], planted)
            if channel.unit == "counts":
                said.append(f"{quantity} in counts")
    if planted.dated is not None:
        started = found.start_ns is not None and abs(found.start_ns - START * 10**9) < 10**9
        said += [] if started == planted.dated else [f"it starts at {found.start_ns}"]
    return said


def differences(t: Array, values: Array, planted: Array, times: Array, one: Dialect) -> list[str]:
    if values.shape != planted.shape:
        return [f"{len(values)} samples of {len(planted)}"]
    away = float(np.abs(values - planted).max())
    late = float(np.abs((t - t[0]) - (times - times[0])).max())
    said = [f"off by {away:.3g}"] if away > one.resolution else []
    return said + ([f"late by {late:.3g} s"] if late > 1e-3 / RATE * 10 else [])


def told_in(found: Recording, wrong: list[str]) -> bool:
    """Whether the notes say what is wrong: fewer samples with their number, a unit that is not
    known, a rate that is not read."""
    notes = "\n".join(found.notes)
    words = {
        r"(\d+) samples of (\d+)": lambda m: str(int(m[2]) - int(m[1])) in notes,
        r"angular_rate in counts": lambda m: "--gyro-unit" in notes,
        r"off by": lambda m: "--gyro-unit" in notes and len(wrong) > 1,
        r"late by": lambda m: "stamps have a resolution" in notes,
        r"angular_rate of \[\]": lambda m: "not read" in notes or "left out" in notes,
    }
    return all(
        any((m := re.match(form, one)) and said(m) for form, said in words.items()) for one in wrong
    )


def verdict_on(planted: Dialect, folder: Path) -> tuple[str, str]:
    """right, told, refused or silent, and why."""
    path = planted.write(folder)
    try:
        found = readers.read(path, planted.mapping)
    except ImucalError as error:
        return ("refused" if error.remedy else "silent"), str(error)
    wrong = wrong_in(found, planted)
    verdict = "silent" if wrong and not told_in(found, wrong) else "told" if wrong else "right"
    return verdict, f"{wrong}; {found.notes}"


@pytest.mark.parametrize("name", DIALECTS)
def test_no_dialect_is_read_wrongly_without_a_word(name: str, tmp_path: Path) -> None:
    planted = DIALECTS[name]
    needs = NEEDS.get(planted.package, [planted.package])
    for module in needs:
        pytest.importorskip(module)
    verdict, why = verdict_on(planted, tmp_path)
    assert verdict == planted.expected, why


@pytest.mark.parametrize("name", SHEETS)
def test_no_sheet_is_read_wrongly_without_a_word(name: str, tmp_path: Path) -> None:
    pytest.importorskip("openpyxl")
    fill, expected = SHEETS[name]
    path = written(fill, tmp_path)
    if expected == "refused":
        with pytest.raises((ImucalError, ValueError)):
            numbers_in(table_cells(path, FieldMapping()))
    else:
        np.testing.assert_array_equal(numbers_in(table_cells(path, FieldMapping())), ROWS)


def numbers_in(cells: Cells) -> Array:
    """The planted columns. Raises ValueError for a cell that is no number."""
    return np.array([[float(c) for c in cells.columns[n]] for n in columns_of(cells)]).T


def columns_of(cells: Cells) -> list[str]:
    """The headings of what was planted, whatever stands around their names."""
    return [next(c for c in cells.columns if c.startswith(name)) for name in NAMES]
