"""The columns of a text table, for a user who must say which of them to read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.contents import Content, listing, norm_of
from imucalib.readers.csv.dialect import Dialect, cells_of, is_number

_ROWS = 50  # of each look


def contents_of(dialect: Dialect, pieces: Sequence[bytes]) -> tuple[Content, ...]:
    """Every column with its median, and every three neighbours whose norm is that of gravity."""
    rows = rows_of(dialect, pieces)
    names = [_address(dialect, i) for i in range(dialect.width)]
    columns: list[Content] = []
    for i, name in enumerate(names):
        if not dialect.numeric[i]:
            example = next((row[i] for row in rows), "")
            columns.append(Content(name, f"text such as '{example[:30]}'", 0))
            continue
        values = _numbers([row[i] for row in rows], dialect.decimal)
        finite = values[np.isfinite(values)]
        median = float(np.median(finite)) if finite.size else float("nan")
        columns.append(Content(name, "numbers", 0, median=median))
    return (*columns, *_triples(dialect, names, rows))


def _triples(dialect: Dialect, names: list[str], rows: list[list[str]]) -> list[Content]:
    """Three neighbours that hardly change their norm while each of them changes: gravity's mark."""
    found = []
    for i in range(dialect.width - 2):
        if not all(dialect.numeric[i : i + 3]):
            continue
        axes = [_numbers([row[k] for row in rows], dialect.decimal) for k in range(i, i + 3)]
        values = np.stack(axes, axis=1)
        values = values[np.isfinite(values).all(axis=1)]
        norms = np.linalg.norm(values, axis=1)
        low, middle, high = np.percentile(norms, [25, 50, 75]) if norms.size else (0.0, 0.0, 0.0)
        turns = values.size and (np.ptp(values, axis=0) > 0.2 * middle).all()
        if middle > 0 and turns and high - low < 0.05 * middle:
            address = ",".join(names[i : i + 3])
            found.append(Content(address, "one vector?", 0, norm=norm_of(values)))
    return found


def like_gravity(dialect: Dialect, pieces: Sequence[bytes], columns: Sequence[int]) -> bool:
    """Whether the median norm of three columns is that of gravity in m/s², g or mg."""
    rows = rows_of(dialect, pieces)
    axes = [_numbers([row[k] for row in rows], dialect.decimal) for k in columns]
    return Content("", "", 0, norm=norm_of(np.stack(axes, axis=1))).like_gravity


def rows_of(dialect: Dialect, pieces: Sequence[bytes]) -> list[list[str]]:
    """The cells of some rows of every look."""
    rows = []
    for number, piece in enumerate(pieces):
        lines = piece.decode("utf-8", errors="replace").split("\n")[:-1]
        lines = lines[dialect.data_line - 1 :] if number == 0 else lines
        step = max(1, len(lines) // _ROWS)
        for line in lines[::step]:
            row = cells_of(line, dialect.delimiter)
            if len(row) >= dialect.width:
                rows.append(row)
    return rows


def _numbers(cells: list[str], decimal: str) -> Array:
    return np.array(
        [float(c.replace(decimal, ".")) if is_number(c, decimal) else np.nan for c in cells]
    )


def _address(dialect: Dialect, column: int) -> str:
    name = dialect.names[column] if dialect.names else ""
    return name if name and dialect.names.count(name) == 1 else str(column + 1)


def nothing_found(dialect: Dialect, pieces: Sequence[bytes], where: str) -> UnreadableInput:
    """The error for a table in which no names tell of an acceleration or an angular rate."""
    held = contents_of(dialect, pieces)
    what = (
        "no acceleration columns among"
        if dialect.names
        else (f"the {dialect.width} columns have no names")
    )
    vectors = [c for c in held if "," in c.address]
    option = vectors[0].address if len(vectors) == 1 else "X,Y,Z"
    return UnreadableInput(
        f"{what}:{listing(held)}\n",
        where=where,
        remedy=f"Name them: --acc {option} (and --gyro, --time or --rate, --unit)",
    )
