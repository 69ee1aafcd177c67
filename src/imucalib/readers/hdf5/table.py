"""The columns of a small table in an HDF5 file, under the names of its datasets and fields."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.hdf5.attributes import text_of
from imucalib.readers.hdf5.fields import datasets
from imucalib.readers.hdf5.file import opened


def table_columns(path: Path) -> dict[str, Array | list[str]]:
    """Every column by name: a dataset (n,), a field of a compound one, x, y, z of one (n, 3).

    Raises UnreadableInput for a damaged file and for columns of different length.
    """
    with opened(path, strict=True) as file:
        nodes = list(datasets(file.handle, str(path)))
        for node in nodes:
            file.demand_whole(node)
        found = dict(part for node in nodes for part in _columns(node))
    if len({len(v) for v in found.values()}) > 1:
        sizes = ", ".join(f"{name} {len(v)}" for name, v in found.items())
        raise UnreadableInput(f"datasets of different length ({sizes})", where=str(path))
    return found


def _columns(node: Any) -> Iterator[tuple[str, Array | list[str]]]:
    values = np.asarray(node[...])
    if values.dtype.names:
        for field in values.dtype.names:
            yield field, _column(values[field])
    elif values.ndim == 1 and values.dtype.kind in "iufSO":
        yield node.name.rsplit("/", maxsplit=1)[-1], _column(values)
    elif values.ndim == 2 and values.shape[1] == 3 and values.dtype.kind in "iuf":
        yield from zip("xyz", values.T.astype(np.float64), strict=True)


def _column(values: Any) -> Array | list[str]:
    if values.dtype.kind in "iuf":
        return np.asarray(values, np.float64)
    return [text_of(value) for value in values]
