"""Whole blocks of rows to numbers with pyarrow's parser, which is faster than numpy's.

pyarrow is optional, so its numbers must be numpy's to the last bit: both round correctly. Where the
two could differ in what they accept, nothing is returned and numpy's parser decides.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array


@cache
def available() -> bool:
    """Whether pyarrow is installed."""
    return importlib.util.find_spec("pyarrow") is not None


def columns_of(
    text: bytes, delimiter: str, width: int,
    stamps: tuple[tuple[int, ...], str] | None, values: Sequence[int],
) -> tuple[list[NDArray[np.generic]], Array] | None:  # fmt: skip
    """Stamps (n,) of each of their columns and values (n, m) of whole lines of `width` cells.

    stamps : their columns and kind ("int", "float" or "text"), or None: there are none then
    None comes back when anything in the columns is not plainly of its kind, and for stamps as text
    of differing length.
    """
    # pyarrow reads hexadecimal integers, and takes a carriage return for the end of a line.
    if delimiter == " " or not text or any(code in text for code in (b"x", b"X", b"\r")):
        return None
    import pyarrow as pa

    of_kind = {"int": pa.int64(), "float": pa.float64(), "text": pa.binary()}
    kinds = {str(k): pa.float64() for k in values}
    if stamps is not None:
        kinds |= {str(k): of_kind[stamps[1]] for k in stamps[0]}
    table = _table(text, delimiter, width, kinds)
    if table is None or any(table.column(name).null_count for name in kinds):
        return None
    found = np.empty((table.num_rows, len(values)))
    for at, k in enumerate(values):
        found[:, at] = table.column(str(k)).to_numpy()
    times = []
    for k in stamps[0] if stamps else ():
        column = table.column(str(k)).combine_chunks()
        part = _texts(column) if stamps and stamps[1] == "text" else column.to_numpy()
        if part is None:
            return None
        times.append(part)
    return times, found


def _table(text: bytes, delimiter: str, width: int, kinds: dict[str, Any]) -> Any:
    import pyarrow as pa
    from pyarrow import csv

    names = [str(k) for k in range(width)]
    try:
        return csv.read_csv(
            pa.py_buffer(text),
            csv.ReadOptions(use_threads=False, block_size=len(text) + 1, column_names=names),
            csv.ParseOptions(delimiter=delimiter, quote_char=False, ignore_empty_lines=False),
            csv.ConvertOptions(
                check_utf8=False, column_types=kinds, include_columns=list(kinds),
                null_values=[], strings_can_be_null=False,
            ),
        )  # fmt: skip
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError):  # numpy's parser finds and names the row
        return None


def _texts(column: Any) -> NDArray[np.bytes_] | None:
    """A binary column as fixed-width text, when all cells are ASCII of one length."""
    _, offsets, data = column.buffers()
    ends = np.frombuffer(offsets, np.int32)[column.offset : column.offset + len(column) + 1]
    lengths = np.diff(ends)
    if not lengths.size or lengths[0] == 0 or (lengths != lengths[0]).any():
        return None
    codes = np.frombuffer(data, np.uint8)[ends[0] : ends[-1]]
    if codes.max() > 127:
        return None
    return codes.view(f"S{lengths[0]}")
