"""Recordings as HDF5: one group a channel, every dataset with its unit and a checksum.

/<triad>/<quantity>/values (N, k) with attributes units, quantity, triad, sampling_rate, and
/<triad>/<quantity>/time (N,) in s; the file has the attributes format, version, start_ns and
corrections. The `units` attribute is the rule of NeXus (manual, "Rules for Storing Data Items").
"""

from __future__ import annotations

from collections.abc import Iterable
from io import FileIO
from pathlib import Path
from typing import Any

from imucalib.arrays import Array
from imucalib.recording.recording import Channel, Recording

FORMAT, VERSION = "imucal recording", 1
_CHUNK_ROWS = 1 << 12  # a flipped byte costs 41 s at 100 Hz; 256 made reading 2.9 times as slow


class Hdf5Writer:
    """Writer of HDF5 files; see `imucalib.writers.Writer`."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5")

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block; memory holds one."""
        import h5py

        with _Output(path, "w+b") as out:
            try:
                with h5py.File(out, "w") as file:
                    _put(file, "format", FORMAT)
                    file.attrs["version"] = VERSION
                    for recording in blocks:
                        _write_block(file, recording)
                        if out.error is not None:
                            break
            finally:
                if out.error is not None:
                    raise out.error


WRITER = Hdf5Writer()


def _write_block(file: Any, recording: Recording) -> None:
    if recording.start_ns is not None:
        file.attrs["start_ns"] = recording.start_ns
    # A name of any bytes is kept as text.
    _put(file, "source_path", recording.path)
    _put(file, "source_sha256", recording.sha256)
    _put(file, "device", recording.device)
    _put(file, "serial", recording.serial)
    _put(file, "corrections", "\n".join(c.to_text() for c in recording.corrections))
    for name, channel in recording.channels.items():
        if name not in file:
            _define(file.create_group(name), channel)
        _append(file[name]["values"], channel.values)
        _append(file[name]["time"], channel.t)


def _define(group: Any, channel: Channel) -> None:
    k = channel.values.shape[1]
    shapes = {"values": (k,), "time": ()}
    for name, tail in shapes.items():
        group.create_dataset(
            name,
            shape=(0, *tail),
            maxshape=(None, *tail),
            chunks=(_CHUNK_ROWS, *tail),
            dtype="f8",
            fletcher32=True,
        )
    _put(group["time"], "units", "s")
    values = group["values"]
    _put(values, "units", channel.unit)
    _put(values, "quantity", channel.quantity)
    _put(values, "triad", channel.triad)
    values.attrs["sampling_rate"] = channel.rate


def _put(node: Any, name: str, text: str) -> None:
    """Write a text as an attribute of fixed length.

    Others lie in a heap of their own, and a damaged heap can keep the library in a loop.
    """
    import h5py

    data = text.encode("utf-8", "backslashreplace")
    node.attrs.create(name, data, dtype=h5py.string_dtype("utf-8", max(1, len(data))))


def _append(dataset: Any, rows: Array) -> None:
    first = dataset.shape[0]
    dataset.resize(first + rows.shape[0], axis=0)
    dataset[first:] = rows


class _Output(FileIO):
    """A file for h5py that keeps the first error of writing and drops what follows.

    A library that cannot finish its file tries again when the process ends, and takes it down.
    """

    error: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write all of it, or note why not."""
        view = memoryview(data).cast("B")
        try:
            while view and self.error is None:
                view = view[super().write(view) :]
        except OSError as error:
            self.error = error
        return len(data)

    def truncate(self, size: int | None = None, /) -> int:
        """Cut or extend."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.error = self.error or error
            return size or 0
