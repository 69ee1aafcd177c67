"""An HDF5 file that may be damaged: opened if at all possible, rows read chunk by chunk if not."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import ImucalError, UnreadableInput
from imucalib.readers.hdf5.attributes import fills_of
from imucalib.readers.hdf5.clock import Place
from imucalib.readers.hdf5.heaps import demand_ends
from imucalib.readers.hdf5.held import Rows, Spans, Walk, absent, mask_of

_RANGES = 3  # of absent rows that are named


@dataclass
class File:
    """An open file, and what of it could not be read.

    external : whether its data may lie in other files
    """

    handle: Any
    where: str
    strict: bool
    lost: list[str] = field(default_factory=list)
    external: bool = False
    nodes: dict[str, Any] = field(default_factory=dict)  # datasets in use: looking one up is slow
    fills: dict[tuple[str, str], list[Any]] = field(default_factory=dict)
    held: dict[tuple[str, int], Spans] = field(default_factory=dict)

    def rows(self, place: Place, start: int, stop: int) -> NDArray[np.generic]:
        """Rows of one place in its unit; those that are damaged or not in the file become NaN."""
        values, held = self.stored(place, start, stop)
        values = place.unpacked(values)
        if held is None:
            return values
        values = values.astype(np.float64)
        values[~held] = np.nan
        return values

    def stored(
        self, place: Place, start: int, stop: int
    ) -> tuple[NDArray[np.generic], Rows | None]:
        """Rows as the file has them, and which of them it has; None when all. Raises
        UnreadableInput for data in another file and, when strict, for what is missing."""
        node = self.nodes.get(place.path)
        if node is None:
            node = self.nodes[place.path] = self.handle[place.path]
        held = mask_of(self._known(node, 1 if place.transposed else 0), start, stop)
        try:
            return self._filled(node, place, _slice(node, place, start, stop), held)
        except (OSError, RuntimeError) as error:
            if self.strict:
                raise UnreadableInput(
                    f"{place.path}, rows {start} to {stop}: {error}", where=self.where
                ) from error
        values, whole = self._by_chunks(node, place, start, stop)
        return self._filled(node, place, values, whole if held is None else whole & held)

    def _filled(
        self, node: Any, place: Place, values: NDArray[np.generic], held: Rows | None
    ) -> tuple[NDArray[np.generic], Rows | None]:
        """The values, and which rows of them hold none of the values that stand for nothing."""
        key = (node.name, place.column)
        if key not in self.fills:
            self.fills[key] = fills_of(node, place.column)
        for fill in self.fills[key]:
            there = (values != fill).reshape(values.shape[0], -1).all(axis=1)
            if not there.all():
                held = there if held is None else held & there
        return values, held

    def _known(self, node: Any, axis: int) -> Spans:
        key = (node.name, axis)
        if key not in self.held:
            found = Walk(Path(self.where), self.external).spans(node, Path(self.where), axis)
            self.held[key] = found
            lost = absent(found, int(node.shape[axis]))
            if len(lost):
                self._report(node.name, lost)
        return self.held[key]

    def demand_whole(self, node: Any) -> None:
        """Raise UnreadableInput, in a strict file, unless it holds all of a dataset."""
        self._known(node, 0)

    def _report(self, name: str, edges: Spans) -> None:
        spans = ", ".join(f"{a} to {b - 1}" for a, b in edges[:_RANGES].tolist())
        more = f" and {len(edges) - _RANGES} more ranges" if len(edges) > _RANGES else ""
        what = f"{name}: rows {spans}{more} are not in the file"
        if self.strict:
            raise UnreadableInput(what, where=self.where, remedy="copy it again from its source")
        self.lost.append(what)

    def _by_chunks(
        self, node: Any, place: Place, start: int, stop: int
    ) -> tuple[NDArray[np.generic], Rows]:
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


def _slice(node: Any, place: Place, start: int, stop: int) -> NDArray[np.generic]:
    if place.column:
        return np.asarray(node[start:stop][place.column])
    if place.triad >= 0:
        return np.asarray(node[start:stop, place.triad, :])
    if place.transposed:
        return np.asarray(node[:, start:stop]).T
    return np.asarray(node[start:stop])


@contextmanager
def opened(path: Path, strict: bool, external: bool = False) -> Iterator[File]:
    import h5py

    demand_ends(path)
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
