"""Which rows of a dataset the file holds: HDF5 gives zeros for all others and says nothing.

Rows are absent where a chunk was never written or its index is damaged, and where a virtual dataset
maps no source or one that is not there. What is known of them takes the memory of the chunks, not
of the rows: a virtual dataset may claim any number of these.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput

Rows = NDArray[np.bool_]
Spans = NDArray[np.int64]  #: (k, 2) first row and end of each stretch that is held, in order
_DEEPEST = 8  # virtual datasets of virtual datasets
#: Rows that a virtual dataset may claim for each that its sources hold, beyond some thousand.
_MOST_RATIO, _FEW = 2000, 1 << 16
_NONE: Spans = np.empty((0, 2), dtype=np.int64)


def outside(node: Any, path: Path) -> str:
    """Another file that holds data of this dataset, or ""."""
    for name, _, _ in node.external or ():
        return str(name)
    if node.is_virtual:
        for source in node.virtual_sources():
            if not _is_own(source.file_name, path):
                return str(source.file_name)
    return ""


def mask_of(spans: Spans, start: int, stop: int) -> Rows | None:
    """Which of some rows are held; None when all are."""
    near = spans[(spans[:, 1] > start) & (spans[:, 0] < stop)]
    if len(near) == 1 and near[0, 0] <= start and near[0, 1] >= stop:
        return None
    held = np.zeros(stop - start, dtype=np.bool_)
    for a, b in (near - start).clip(0, stop - start).tolist():
        held[a:b] = True
    return held


def absent(spans: Spans, rows: int) -> Spans:
    """The stretches between those that are held."""
    edges = np.concatenate([[0], spans.reshape(-1), [rows]]).reshape(-1, 2)
    return np.asarray(edges[edges[:, 1] > edges[:, 0]])


@dataclass
class Walk:
    """A look at the datasets of one file and, where that is allowed, of those it refers to.

    where : of the file, for errors; found : what is known of each dataset; None while it is looked
        at: one that is met again then is a part of itself, which the library reads until it dies
    """

    path: Path
    external: bool = False
    found: dict[tuple[str, str, int], Spans | None] = field(default_factory=dict)

    def spans(self, node: Any, path: Path, axis: int = 0, depth: int = 0) -> Spans:
        """The rows along `axis` that are there; sources of virtual datasets are opened.

        Raises UnreadableInput for data elsewhere, where that is not allowed, and for virtual
        datasets that have no end.
        """
        key = (str(path.resolve()), node.name, axis)
        if key in self.found:
            known = self.found[key]
            if known is None or depth > _DEEPEST:
                raise self._refused(node, "is a part of itself", "write its values to a file")
            return known
        other = "" if self.external else outside(node, path)
        if other:
            raise UnreadableInput(
                f"{node.name} lies in another file, {other}", where=str(self.path),
                remedy="read it with --allow-external if you trust this file",
            )  # fmt: skip
        self.found[key] = None
        rows = int(node.shape[axis])
        everything = np.array([[0, rows]], dtype=np.int64)
        if node.is_virtual:
            held = self._virtual(node, path, axis, depth)
        elif node.external:
            held = everything if _external_is_whole(node) else _NONE
        elif node.chunks is not None:
            held = _chunked(node, axis)
        else:
            # 0 bytes: storage that is allocated at the first write, which never came.
            held = everything if node.id.get_storage_size() else _NONE
        self.found[key] = held
        return held

    def _refused(self, node: Any, what: str, remedy: str) -> UnreadableInput:
        return UnreadableInput(f"{node.name} {what}", where=str(self.path), remedy=remedy)

    def _virtual(self, node: Any, path: Path, axis: int, depth: int) -> Spans:
        rows = int(node.shape[axis])
        width = int(np.prod(node.shape, dtype=object)) // max(1, rows)
        steps: dict[int, int] = {}
        for source in node.virtual_sources():
            try:
                low, high = source.vspace.get_select_bounds()
            except ValueError:  # it has no end
                low, high = (0,) * len(node.shape), tuple(n - 1 for n in node.shape)
            block = np.array(high) - np.array(low) + 1
            points = int(source.vspace.get_select_npoints())
            whole = points == int(np.prod(block, dtype=object))
            # A selection with holes is not taken for whole; what it refers to is looked at anyway.
            if not self._source_is_whole(source, node, path, depth) or not whole:
                continue
            each = points // int(block[axis])
            steps[int(low[axis])] = steps.get(int(low[axis]), 0) + each
            steps[int(high[axis]) + 1] = steps.get(int(high[axis]) + 1, 0) - each
        edges = np.array(sorted(steps), dtype=np.int64)
        covered = np.cumsum([steps[int(e)] for e in edges]) >= width
        held = _joined(edges, covered)
        there = int((held[:, 1] - held[:, 0]).sum())
        if rows > _MOST_RATIO * max(there, _FEW):
            raise self._refused(
                node, f"claims {rows} rows, and its sources hold {there}",
                "write the rows that there are to a file",
            )  # fmt: skip
        return held

    def _source_is_whole(self, source: Any, node: Any, path: Path, depth: int) -> bool:
        import h5py

        try:
            if _is_own(source.file_name, path):
                return self._has_all(source, node.file, path, depth)
            other = path.parent / source.file_name
            with h5py.File(other, "r") as file:
                return self._has_all(source, file, other, depth)
        except (OSError, RuntimeError, KeyError, ValueError):
            return False

    def _has_all(self, source: Any, file: Any, path: Path, depth: int) -> bool:
        """Whether the source has every row that it is asked for."""
        found = file.get(source.dset_name)
        if found is None or not getattr(found, "shape", ()):
            return False
        held = self.spans(found, path, 0, depth + 1)
        try:
            low, high = source.src_space.get_select_bounds()
        except ValueError:  # all of it, of a size that the library has not looked up
            return int(source.vspace.get_select_npoints()) == found.size and (
                mask_of(held, 0, int(found.shape[0])) is None
            )
        if len(high) != len(found.shape) or any(
            h >= n for h, n in zip(high, found.shape, strict=True)
        ):
            return False
        return mask_of(held, int(low[0]), int(high[0]) + 1) is None


def _joined(edges: NDArray[np.int64], held: Rows) -> Spans:
    """Stretches between edges, the neighbours of those that are held in one."""
    if not edges.size:
        return _NONE
    change = np.flatnonzero(np.diff(held.astype(np.int8), prepend=0, append=0))
    return np.asarray(edges[change[: change.size // 2 * 2]].reshape(-1, 2))


def _chunked(node: Any, axis: int) -> Spans:
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
    whole = count >= int(np.prod(across, dtype=np.int64))
    edges = np.minimum(np.arange(count.size + 1) * step, rows)
    return _joined(edges, np.append(whole, False))


def _external_is_whole(node: Any) -> bool:
    for name, offset, size in node.external:
        other = Path(name)  # the library looks in the working directory, not beside the file
        needed = offset + min(size, node.size * node.dtype.itemsize)
        if not other.is_file() or other.stat().st_size < needed:
            return False
    return True


def _is_own(name: str, path: Path) -> bool:
    return name == "." or (path.parent / name).resolve() == path.resolve()
