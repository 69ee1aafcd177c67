"""The datasets of an HDF5 file, for a user who must say which of them to read."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.readers.contents import Content, norm_of
from imucalib.readers.hdf5.attributes import unit_of
from imucalib.readers.hdf5.held import Walk

_ROWS = 500


def contents_of(held: Iterable[Any], where: str) -> tuple[Content, ...]:
    """Every dataset with its shape, type and unit, and the norm or median of its first rows."""
    return tuple(_content(node, Path(where)) for node in held)


def _content(node: Any, path: Path) -> Content:
    shape = " x ".join(map(str, node.shape[1:]))
    fields = f" of {', '.join(node.dtype.names)}" if node.dtype.names else ""
    unit = unit_of(node)
    kind = f"{shape + ' ' if shape else ''}{node.dtype if not fields else 'records'}{fields}"
    kind += f" in {unit}" if unit else ""
    norm = median = float("nan")
    try:
        Walk(path).spans(node, path)
    except UnreadableInput as error:
        why = error.what.removeprefix(f"{node.name} ")
        return Content(node.name, kind, node.shape[0], why=f"it {why}")
    numeric = not fields and node.dtype.kind in "iuf"
    step = max(1, node.shape[0] // _ROWS)
    try:
        if numeric and node.shape[1:] == (3,):
            norm = norm_of(np.asarray(node[::step], dtype=np.float64))
        elif numeric and len(node.shape) == 1:
            values = np.asarray(node[::step], dtype=np.float64)
            median = float(np.median(values[np.isfinite(values)]))
    except (OSError, RuntimeError):
        return Content(node.name, kind, node.shape[0], why="its first rows cannot be read")
    return Content(node.name, kind, node.shape[0], norm=norm, median=median)
