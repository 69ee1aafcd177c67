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
from imucalib.readers.hdf5.clock import Place


@dataclass
class File:
    """An open file, and what of it could not be read."""

    handle: Any
    where: str
    strict: bool
    lost: list[str] = field(default_factory=list)
    nodes: dict[str, Any] = field(default_factory=dict)  # datasets in use: looking one up is slow

    def rows(self, place: Place, start: int, stop: int) -> NDArray[np.generic]:
        """Rows of one place; rows of a damaged chunk become NaN (or 0 in integers, see `lost`)."""
        node = self.nodes.get(place.path)
        if node is None:
            node = self.nodes[place.path] = self.handle[place.path]
        try:
            return _slice(node, place, start, stop)
        except (OSError, RuntimeError) as error:
            if self.strict:
                raise UnreadableInput(
                    f"{place.path}, rows {start} to {stop}: {error}", where=self.where
                ) from error
        return self._by_chunks(node, place, start, stop)

    def _by_chunks(self, node: Any, place: Place, start: int, stop: int) -> NDArray[np.generic]:
        step = node.chunks[1 if place.transposed else 0] if node.chunks else stop - start
        parts: list[NDArray[np.generic]] = []
        a = start
        while a < stop:
            b = min(stop, (a // step + 1) * step)
            try:
                parts.append(_slice(node, place, a, b).astype(np.float64))
            except (OSError, RuntimeError) as error:
                note = f"{place.path}: rows {a} to {b - 1} cannot be read ({_reason(error)})"
                self.lost.append(note)
                width = () if place.column or len(node.shape) == 1 else (3,)
                parts.append(np.full((b - a, *width), np.nan))
            a = b
        return np.concatenate(parts)


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
def opened(path: Path, strict: bool) -> Iterator[File]:
    import h5py

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
        yield File(handle, str(path), strict, notes)
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
