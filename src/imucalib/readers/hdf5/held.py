"""Which rows of a dataset the file holds: HDF5 gives zeros for all others and says nothing.

Rows are absent where a chunk was never written or its index is damaged, and where a virtual dataset
maps no source or one that is not there.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.bool_]
_DEEPEST = 8  # virtual datasets of virtual datasets


def outside(node: Any, path: Path) -> str:
    """Another file that holds data of this dataset, or ""."""
    for name, _, _ in node.external or ():
        return str(name)
    if node.is_virtual:
        for source in node.virtual_sources():
            if not _is_own(source.file_name, path):
                return str(source.file_name)
    return ""


def held_rows(node: Any, path: Path, axis: int = 0, depth: int = 0) -> Rows:
    """(n,) whether each row along `axis` is there; sources of virtual datasets are opened."""
    rows = int(node.shape[axis])
    everything = np.ones(rows, dtype=np.bool_)
    if node.is_virtual:
        return _virtual(node, path, axis, depth)
    if node.external:
        return everything if _external_is_whole(node) else ~everything
    if node.chunks is not None:
        return _chunked(node, axis)
    # 0 bytes: storage that is allocated at the first write, which never came.
    return everything if node.id.get_storage_size() else ~everything


def _chunked(node: Any, axis: int) -> Rows:
    rows, step = int(node.shape[axis]), int(node.chunks[axis])
    across = [-(-n // c) for n, c in zip(node.shape, node.chunks, strict=True)]
    across[axis] = 1
    count = np.zeros(-(-rows // step), dtype=np.int64)

    def add(chunk: Any) -> None:
        number = chunk.chunk_offset[axis] // step
        if number < count.size:
            count[number] += 1

    # Where the index is damaged, what was found until then is known.
    with suppress(OSError, RuntimeError):
        node.id.chunk_iter(add)
    return np.repeat(count >= int(np.prod(across, dtype=np.int64)), step)[:rows]


def _virtual(node: Any, path: Path, axis: int, depth: int) -> Rows:
    held = np.zeros(int(node.shape[axis]), dtype=np.bool_)
    if depth >= _DEEPEST:
        return held
    width = int(np.prod(node.shape)) // max(1, held.size)
    covered = np.zeros(held.size, dtype=np.int64)
    for source in node.virtual_sources():
        low, high = source.vspace.get_select_bounds()
        block = np.array(high) - np.array(low) + 1
        points = int(source.vspace.get_select_npoints())
        if points != int(np.prod(block)) or not _source_is_whole(source, node, path, depth):
            continue  # a selection with holes is not taken for whole
        covered[low[axis] : high[axis] + 1] += points // int(block[axis])
    held[:] = covered >= width
    return held


def _source_is_whole(source: Any, node: Any, path: Path, depth: int) -> bool:
    import h5py

    try:
        if _is_own(source.file_name, path):
            return _has_all(source, node.file, path, depth)
        other = path.parent / source.file_name
        with h5py.File(other, "r") as file:
            return _has_all(source, file, other, depth)
    except (OSError, RuntimeError, KeyError, ValueError):
        return False


def _has_all(source: Any, file: Any, path: Path, depth: int) -> bool:
    """Whether the source has every row that it is asked for."""
    found = file.get(source.dset_name)
    if found is None or not getattr(found, "shape", ()):
        return False
    try:
        low, high = source.src_space.get_select_bounds()
    except ValueError:  # all of it, of a size that the library has not looked up
        return int(source.vspace.get_select_npoints()) == found.size and bool(
            held_rows(found, path, 0, depth + 1).all()
        )
    if len(high) != len(found.shape) or any(h >= n for h, n in zip(high, found.shape, strict=True)):
        return False
    return bool(held_rows(found, path, 0, depth + 1)[low[0] : high[0] + 1].all())


def _external_is_whole(node: Any) -> bool:
    for name, offset, size in node.external:
        other = Path(name)  # the library looks in the working directory, not beside the file
        needed = offset + min(size, node.size * node.dtype.itemsize)
        if not other.is_file() or other.stat().st_size < needed:
            return False
    return True


def _is_own(name: str, path: Path) -> bool:
    return name == "." or (path.parent / name).resolve() == path.resolve()
