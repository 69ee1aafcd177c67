"""HDF5 recordings of any layout: fields are found by walking the file (`hdf5_fields`).

A file whose writer was killed is read in SWMR mode; a chunk with a bad checksum costs only its
rows, and the recording says which.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.contents import listing, suggestion
from imucalib.readers.hdf5.attributes import text_of
from imucalib.readers.hdf5.contents import contents_of
from imucalib.readers.hdf5.fields import datasets, fields_of
from imucalib.readers.hdf5.file import File, opened
from imucalib.readers.hdf5.signals import Signal, resolved_mapping, signals_of, stored_rows, times
from imucalib.readers.joining import join
from imucalib.readers.source import sha256_of
from imucalib.readers.timebase import find_gaps
from imucalib.recording.correction import corrections_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

_SIGNATURE = b"\x89HDF\r\n\x1a\n"


class Hdf5Reader:
    """Reader of HDF5 files; see `imucalib.readers.Reader`."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5", ".hdf", ".he5", ".nxs", ".mat")

    def recognises(self, path: Path, head: bytes) -> bool:
        """The HDF5 signature, at the start or after a user block."""
        return any(head[k : k + 8] == _SIGNATURE for k in (0, 512, 1024, 2048, 4096))

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield the fields in blocks of about `block_samples` rows."""
        with opened(path, strict, bool(mapping.allow_external)) as file:
            yield from blocks_of(file, path, mapping, block_samples)

    def stored_blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """The same blocks with the numbers as the file has them; see `readers.stored_blocks`."""
        with opened(path, strict, bool(mapping.allow_external)) as file:
            yield from blocks_of(file, path, mapping, block_samples, stored=True)

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read the whole file."""
        return join(self.blocks(path, mapping, block_samples=1 << 20, strict=strict), str(path))


READER = Hdf5Reader()


def blocks_of(
    file: File, path: Path, mapping: FieldMapping, size: int, *, stored: bool = False
) -> Iterator[Recording]:
    """The fields of an open file in blocks of about `size` rows; errors as in `Reader.blocks`."""
    nodes = list(datasets(file.handle, file.where))
    found = fields_of(file.handle, nodes, mapping)
    if not any(f.quantity != "temperature" for f in found):
        held = contents_of(nodes, file.where)
        raise UnreadableInput(
            f"no inertial dataset was found among:{listing(held) or ' none'}\n",
            where=file.where,
            remedy="Name them with --acc, --gyro and --time or --rate (dataset paths)"
            + suggestion(held),
        )
    signals, start_ns, notes = signals_of(file, found, mapping)
    resolved = resolved_mapping(mapping, signals)
    marks = corrections_of(text_of(file.handle.attrs.get("corrections", "")).split("\n"))
    empty = Recording(
        {}, str(path), "hdf5", sha256_of(path), start_ns, mapping=resolved.to_dict(),
        corrections=marks,
    )  # fmt: skip
    last: dict[str, float] = {}
    at = {s.name: 0 for s in signals}
    main = max(signals, key=lambda s: s.found.rows)
    first = True
    while first or any(at[s.name] < s.found.rows for s in signals):
        until = _time_after(file, main, at[main.name] + size)
        channels, gaps = {}, {}
        for signal in signals:
            stop = _stop(file, signal, main, at[signal.name], size=size, until=until)
            channel, new = _channel(file, signal, at[signal.name], stop, last)
            if channel is not None and not stored:
                channel = _converted(channel)
            at[signal.name] = stop
            if channel is not None:
                channels[signal.name] = channel
            gaps.update({(g.start, g.stop): g for g in new})
        own = [*notes, *map(str, marks), *file.lost] if first else file.lost
        yield replace(empty, channels=channels, gaps=tuple(gaps.values()), notes=tuple(own))
        file.lost, first = [], False


def _time_after(file: File, signal: Signal, row: int) -> float:
    """Time of a row of the main channel, or infinity past its end."""
    if row >= signal.found.rows:
        return float("inf")
    t = times(file, signal, row, row + 1)
    return float(t[0]) if np.isfinite(t[0]) else float("-inf")


def _stop(file: File, signal: Signal, main: Signal, row: int, *, size: int, until: float) -> int:
    """Where this channel's block ends: at the main channel's row, or at its time."""
    rows = signal.found.rows
    same = signal.found.time == main.found.time and signal.found.rate == main.found.rate
    if same and rows == main.found.rows:
        return min(rows, row + size)
    if until == float("inf"):
        return rows
    while row < rows:
        t = times(file, signal, row, min(rows, row + size))
        inside = int(np.searchsorted(t, until))
        row += inside
        if inside < t.size:
            break
    return row


def _channel(
    file: File, signal: Signal, start: int, stop: int, last: dict[str, float]
) -> tuple[Channel | None, list[Gap]]:
    """The channel with its conversion pending, and its gaps."""
    if stop <= start:
        return None, []
    found, how = signal.found, signal.conversion
    t, raw = times(file, signal, start, stop), stored_rows(file, found, start, stop)
    rows: Array | range = range(start, stop)
    counted = found.time is None
    if not ((counted or _finite(t)) and _finite(raw)):
        usable = np.isfinite(t) & np.isfinite(raw).all(axis=1)
        if not usable.any():
            return None, []
        t, raw, rows = t[usable], raw[usable], np.arange(start, stop)[usable]
    gaps = []
    if found.quantity != "temperature":
        # Times that are counted have no gap where no row was left out.
        new = slice(0, 1) if counted and isinstance(rows, range) else slice(None)
        gaps = find_gaps(t[new], rows[new], signal.threshold, last.get(signal.name))
    last[signal.name] = float(t[-1])
    values = cast(Array, raw)  # of the type that the file has, while the conversion is pending
    return Channel(
        t=t,
        values=values,
        unit=how.unit,
        quantity=found.quantity,
        triad=found.triad,
        rate=signal.rate,
        pending=how,
        names=(found.address,) if found.address else (),
        numbered=found.numbered,
    ), gaps


def _finite(values: NDArray[np.generic]) -> bool:
    """Whether all are: a sum that is finite has no other terms, and is faster than a look."""
    if values.dtype.kind in "iu":
        return True
    with np.errstate(invalid="ignore", over="ignore"):
        return bool(np.isfinite(np.sum(values)) or np.isfinite(values).all())


def _converted(channel: Channel) -> Channel:
    assert channel.pending is not None
    return replace(channel, values=channel.pending.apply(channel.values), pending=None)
