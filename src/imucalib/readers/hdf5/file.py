"""An HDF5 file that may be damaged: opened if at all possible, rows read chunk by chunk if not.

- The C library walks a heap of texts from object to object by their sizes; one whose size is
  nothing leads it nowhere, and no signal ends that. So heaps are walked here first. Layout: HDF5
  File Format Specification, III.E, "Global Heap".
- HDF5 gives zeros for rows that the file does not hold, and says nothing: where a chunk was never
  written or its index is damaged, and where a virtual dataset maps no source or one that is not
  there. What is known of them takes the memory of the chunks, not of the rows: a virtual dataset
  may claim any number of these.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers.fields.timebase import seconds_of
from imucalib.readers.hdf5.fields import FieldChannel, FieldPlace, fills_of, valid_of

_MARK, _SIZE = b"GCOL\x01\0\0\0", struct.Struct("<Q")
_OBJECT = struct.Struct("<HHIQ")  # number (0: free space), uses, nothing, size
#: Bytes searched at each end of a file: where writers put what they write before and after data.
_SPAN, _PIECE = 32 << 20, 4 << 20  # and how many are held at a time
_LARGEST = 1 << 20  # of a heap; the library makes them of 4 KiB, or as large as one text needs
_DEEPEST = 8  # virtual datasets of virtual datasets
_RANGES = 3  # of absent rows that are named
Spans = NDArray[np.int64]  #: (k, 2) first row and end of each stretch that is held, in order
_NONE: Spans = np.empty((0, 2), dtype=np.int64)


def _demand_heaps_end(path: Path) -> None:
    """Raise UnreadableInput for a heap whose walk would not end."""
    size = path.stat().st_size
    spans = ((0, min(_SPAN, size)), (max(_SPAN, size - _SPAN), size))
    with path.open("rb") as file:
        for start in (k for first, last in spans for k in range(first, last, _PIECE)):
            file.seek(start)
            # Of the heaps that begin in the piece; what follows lets them end.
            data = file.read(_PIECE + _LARGEST)
            at = data.find(_MARK, 0, _PIECE + len(_MARK) - 1)
            while at >= 0:
                if not _ends(data, at):
                    raise UnreadableInput(
                        "a heap of texts is damaged",
                        where=f"{path}, byte {start + at}",
                        remedy="copy it again from its source",
                    )
                at = data.find(_MARK, at + 1, _PIECE + len(_MARK) - 1)


def _ends(data: bytes, start: int) -> bool:
    if start + 16 > len(data):
        return True
    (size,) = _SIZE.unpack_from(data, start + 8)
    at, stop = start + 16, min(start + min(size, _LARGEST), len(data))
    while at + _OBJECT.size <= stop:
        number, _, _, length = _OBJECT.unpack_from(data, at)
        # As the library counts: an object is filled up to eight bytes, in 64 bits.
        step = (_OBJECT.size + (length + 7 & ~7) if number else length) % (1 << 64)
        if step == 0:
            return False
        at += step
    return True


def _outside(node: Any, path: Path) -> str:
    """Another file that holds data of this dataset, or ""."""
    names = [str(name) for name, _, _ in node.external or ()]
    if node.is_virtual:
        sources = (str(source.file_name) for source in node.virtual_sources())
        names += [name for name in sources if not _is_own(name, path)]
    return names[0] if names else ""


def _mask_of(spans: Spans, start: int, stop: int) -> Flags | None:
    """Which of some rows are held; None when all are."""
    some = spans[(spans[:, 1] > start) & (spans[:, 0] < stop)]
    if len(some) == 1 and some[0, 0] <= start and some[0, 1] >= stop:
        return None
    held = np.zeros(stop - start, dtype=np.bool_)
    for a, b in (some - start).clip(0, stop - start).tolist():
        held[a:b] = True
    return held


@dataclass
class FileWalk:
    """A look at the datasets of one file and, where that is allowed, of those it refers to.

    where : of the file, for errors; found : what is known of each dataset; None while it is looked
        at: one that is met again then is a part of itself, which the library reads until it dies
    """

    where: str
    external: bool = False
    found: dict[tuple[str, str, int], Spans | None] = field(default_factory=dict)

    def spans(self, node: Any, path: Path, axis: int = 0, depth: int = 0) -> Spans:
        """The rows along `axis` that are there; sources of virtual datasets are opened.

        Raises UnreadableInput for data elsewhere, where that is not allowed, and for virtual
        datasets that have no end or lack a source.
        """
        key = (str(path.resolve()), node.name, axis)
        if key in self.found:
            known = self.found[key]
            if known is None or depth > _DEEPEST:
                raise self._refused(node, "is a part of itself", "write its values to a file")
            return known
        other = "" if self.external else _outside(node, path)
        if other:
            remedy = "read it with --allow-external if you trust this file"
            raise self._refused(node, f"lies in another file, {other}", remedy)
        self.found[key] = None
        if node.chunks is not None and not node.is_virtual:
            held = _chunked(node, axis)
        else:
            # 0 bytes: storage that is allocated at the first write, which never came.
            whole = node.is_virtual or node.external or node.id.get_storage_size()
            if node.is_virtual:
                self._demand_sources(node, path, depth)
            elif node.external:
                whole = _external_is_whole(node)
            held = np.array([[0, node.shape[axis]]] if whole else _NONE, dtype=np.int64)
        self.found[key] = held
        return held

    def _refused(self, node: Any, what: str, remedy: str) -> UnreadableInput:
        return UnreadableInput(f"{node.name} {what}", where=self.where, remedy=remedy)

    def _demand_sources(self, node: Any, path: Path, depth: int) -> None:
        """Raise UnreadableInput unless the sources of a virtual dataset fill all of it."""
        filled = 0
        for source in node.virtual_sources():
            if not self._is_whole(source, node, path, depth):
                what = f"needs {source.dset_name} of {source.file_name}, which is not whole"
                raise self._refused(node, what, "copy the files again, together")
            filled += int(source.vspace.get_select_npoints())
        if filled < node.size:
            what = f"claims {node.size} values, and its sources hold {filled}"
            raise self._refused(node, what, "write the values that there are to a file")

    def _is_whole(self, source: Any, node: Any, path: Path, depth: int) -> bool:
        import h5py

        other = path if _is_own(source.file_name, path) else path.parent / source.file_name
        try:
            with h5py.File(other, "r") if other != path else nullcontext(node.file) as file:
                found = file[source.dset_name]
                held = self.spans(found, other, 0, depth + 1)
                if _mask_of(held, 0, int(found.shape[0])) is not None:
                    return False
                try:
                    _, high = source.src_space.get_select_bounds()
                except ValueError:  # all of it, of a size that the library has not looked up
                    return bool(source.vspace.get_select_npoints() == found.size)
                return len(high) == len(found.shape) and bool((high < np.array(found.shape)).all())
        except (OSError, RuntimeError, KeyError, ValueError, AttributeError, IndexError):
            return False


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
    edges = np.flatnonzero(np.diff(whole.astype(np.int8), prepend=0, append=0))
    return np.asarray(np.minimum(edges * step, rows), np.int64).reshape(-1, 2)


def _external_is_whole(node: Any) -> bool:
    for name, offset, size in node.external:
        other = Path(name)  # the library looks in the working directory, not beside the file
        needed = offset + min(size, node.size * node.dtype.itemsize)
        if not other.is_file() or other.stat().st_size < needed:
            return False
    return True


def _is_own(name: str, path: Path) -> bool:
    return name == "." or (path.parent / name).resolve() == path.resolve()


@dataclass
class File:
    """An open file, and what of it could not be read.

    external : whether its data may lie in other files; clock : times of the rows that were read
    last, with what they are, for the next channel that has them
    """

    handle: Any
    where: str
    strict: bool
    lost: list[str] = field(default_factory=list)
    external: bool = False
    nodes: dict[str, Any] = field(default_factory=dict)  # datasets in use: looking one up is slow
    fills: dict[tuple[str, str], tuple[list[Any], tuple[float, float]]] = field(
        default_factory=dict
    )
    held: dict[tuple[str, int], Spans] = field(default_factory=dict)
    clock: tuple[tuple[Any, ...], Array] | None = None

    def times(self, one: FieldChannel, start: int, stop: int) -> Array:
        """Seconds since the start of rows of a channel; NaN where a damaged chunk hides them."""
        if one.time is None:
            return np.arange(start, stop, dtype=np.float64) / (one.rate or 1.0)
        key = one.time, start, stop, one.origin, one.time_unit, one.shift
        if self.clock is None or self.clock[0] != key:  # channels of one clock
            found, held = self.stored(one.time, start, stop)
            t = seconds_of(one.time.unpacked(found).reshape(-1), one.origin, one.time_unit)
            t = t + one.shift if one.shift else t
            if held is not None:
                t[~held] = np.nan
            self.clock = key, t
        return self.clock[1]

    def values(self, one: FieldChannel, start: int, stop: int) -> NDArray[np.generic]:
        """Rows (n, 3) of a channel, or (n, 1) of a temperature, in the stated unit and the type of
        the file, as far as no factor has to be applied."""
        parts = [self.rows(p, start, stop) for p in one.parts]
        if len(parts) == 1:
            order, whole = one.parts[0].order, parts[0].reshape(stop - start, -1)
            return whole if order == (0, 1, 2) else whole[:, order]
        return np.stack([p.reshape(-1) for p in parts], axis=1)

    def rows(self, place: FieldPlace, start: int, stop: int) -> NDArray[np.generic]:
        """Rows of one place in its unit; those that are damaged or not in the file become NaN."""
        values, held = self.stored(place, start, stop)
        values = place.unpacked(values)
        if held is None:
            return values
        values = values.astype(np.float64)
        values[~held] = np.nan
        return values

    def stored(
        self, place: FieldPlace, start: int, stop: int
    ) -> tuple[NDArray[np.generic], Flags | None]:
        """Rows as the file has them, and which of them it has; None when all. Raises
        UnreadableInput for data in another file and, when strict, for what is missing."""
        node = self.nodes.get(place.path)
        if node is None:
            node = self.nodes[place.path] = self.handle[place.path]
        held = _mask_of(self._known(node, 1 if place.transposed else 0), start, stop)
        try:
            return self._fill(node, place, _slice(node, place, start, stop), held)
        except (OSError, RuntimeError) as error:
            if self.strict:
                raise UnreadableInput(
                    f"{place.path}, rows {start} to {stop}: {error}", where=self.where
                ) from error
        values, whole = self._by_chunks(node, place, start, stop)
        return self._fill(node, place, values, whole if held is None else whole & held)

    def _fill(
        self, node: Any, place: FieldPlace, values: NDArray[np.generic], held: Flags | None
    ) -> tuple[NDArray[np.generic], Flags | None]:
        """The values, and which rows of them hold none of the values that stand for nothing."""
        key = (node.name, place.column)
        if key not in self.fills:
            self.fills[key] = fills_of(node, place.column), valid_of(node, place.column)
        fills, (low, high) = self.fills[key]
        wrong = [np.asarray(values == fill) for fill in fills]
        if (low, high) != (-np.inf, np.inf):
            wrong.append(np.less(values, low) | np.greater(values, high))
        for cells in wrong:
            there: Flags = np.logical_not(cells.reshape(values.shape[0], -1).any(axis=1))
            if not there.all():
                held = there if held is None else held & there
        return values, held

    def _known(self, node: Any, axis: int) -> Spans:
        key, rows = (node.name, axis), int(node.shape[axis])
        if key not in self.held:
            path = Path(self.where)
            self.held[key] = found = FileWalk(self.where, self.external).spans(node, path, axis)
            edges = np.concatenate([[0], found.reshape(-1), [rows]]).reshape(-1, 2)
            lost = edges[edges[:, 1] > edges[:, 0]].tolist()
            if lost:
                spans = ", ".join(f"{a} to {b - 1}" for a, b in lost[:_RANGES])
                more = f" and {len(lost) - _RANGES} more ranges" if len(lost) > _RANGES else ""
                self._lose(f"{node.name}: rows {spans}{more} are not in the file")
        return self.held[key]

    def _lose(self, what: str) -> None:
        if self.strict:
            raise UnreadableInput(what, where=self.where, remedy="copy it again from its source")
        self.lost.append(what)

    def demand_whole(self, node: Any) -> None:
        """Raise UnreadableInput, in a strict file, unless it holds all of a dataset."""
        self._known(node, 0)

    def _by_chunks(
        self, node: Any, place: FieldPlace, start: int, stop: int
    ) -> tuple[NDArray[np.generic], Flags]:
        """What can be read of rows some of which cannot, the others as zeros, and which."""
        step = node.chunks[1 if place.transposed else 0] if node.chunks else stop - start
        parts: list[NDArray[np.generic]] = []
        held = np.ones(stop - start, dtype=np.bool_)
        a = start
        while a < stop:
            b = min(stop, (a // step + 1) * step)
            try:
                parts.append(_slice(node, place, a, b))
            except (OSError, RuntimeError) as error:
                note = f"{place.path}: rows {a} to {b - 1} cannot be read ({_reason(error)})"
                self.lost.append(note)
                kind = node.dtype[place.column] if place.column else node.dtype
                across = node.shape[0] if place.transposed else 3
                width = () if place.column or len(node.shape) == 1 else (across,)
                parts.append(np.zeros((b - a, *width), dtype=kind))
                held[a - start : b - start] = False
            a = b
        return np.concatenate(parts), held


def _reason(error: Exception) -> str:
    text = str(error)
    return "checksum" if "checksum" in text.lower() or "filter" in text.lower() else text[:120]


def _slice(node: Any, place: FieldPlace, start: int, stop: int) -> NDArray[np.generic]:
    if place.column:
        return np.asarray(node[start:stop][place.column])
    if place.triad >= 0:
        return np.asarray(node[start:stop, place.triad, :])
    if place.transposed:
        return np.asarray(node[:, start:stop]).T
    return np.asarray(node[start:stop])


@contextmanager
def open_file(path: Path, strict: bool, external: bool = False) -> Iterator[File]:
    import h5py

    _demand_heaps_end(path)
    try:
        handle, notes = h5py.File(path, "r"), []
    except Exception as first:  # cut, or not closed by its writer: the second way in tells which
        try:
            handle = h5py.File(path, "r", swmr=True)
        except Exception:  # whatever the library raises here, the first reason is the telling one
            raise UnreadableInput(
                f"the HDF5 file cannot be opened: {first}",
                where=str(path),
                remedy="it may be cut or still open in its writer: copy it again when closed",
            ) from first
        notes = ["the writer did not close this file; it was read as far as it was flushed"]
        if strict:
            handle.close()
            raise UnreadableInput(notes[0], where=str(path)) from first
    try:
        yield File(handle, str(path), strict, notes, external)
    except ImucalError:
        raise
    except Exception as error:  # damaged metadata makes the C library raise almost anything
        raise UnreadableInput(
            f"the HDF5 file is damaged: {type(error).__name__}: {error}",
            where=str(path),
            remedy="copy it again from its source",
        ) from error
    finally:
        handle.close()
