"""Recordings as HDF5: one group a channel, every dataset with its unit and a checksum.

/<triad>/<quantity>/values (N, k) with attributes units, quantity, triad, sampling_rate, and
/<triad>/<quantity>/time (N,) in s; the file has the attributes format, version, start_ns and
corrections. The `units` attribute is the rule of NeXus (manual, "Rules for Storing Data Items").
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from imucalib.recording.recording import Array, Channel, Recording

FORMAT, VERSION = "imucal recording", 1
_CHUNK_ROWS = 1 << 14


class Hdf5Writer:
    """Writer of HDF5 files; see `imucalib.writers.Writer`."""

    name = "hdf5"
    suffixes = (".h5", ".hdf5")

    def write(self, recording: Recording, path: Path) -> None:
        """Write all channels; a flipped bit in them is found when they are read."""
        self.write_blocks([recording], path)

    def write_blocks(self, blocks: Iterable[Recording], path: Path) -> None:
        """Write block after block; memory holds one."""
        import h5py

        with h5py.File(path, "w") as file:
            file.attrs["format"], file.attrs["version"] = FORMAT, VERSION
            for recording in blocks:
                if recording.start_ns is not None:
                    file.attrs["start_ns"] = recording.start_ns
                file.attrs["source_path"] = recording.path
                file.attrs["source_sha256"] = recording.sha256
                file.attrs["corrections"] = "\n".join(c.to_text() for c in recording.corrections)
                for name, channel in recording.channels.items():
                    if name not in file:
                        _define(file.create_group(name), channel)
                    _append(file[name]["values"], channel.values)
                    _append(file[name]["time"], channel.t)


WRITER = Hdf5Writer()


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
    group["time"].attrs["units"] = "s"
    values = group["values"].attrs
    values["units"], values["quantity"] = channel.unit, channel.quantity
    values["triad"], values["sampling_rate"] = channel.triad, channel.rate


def _append(dataset: Any, rows: Array) -> None:
    first = dataset.shape[0]
    dataset.resize(first + rows.shape[0], axis=0)
    dataset[first:] = rows
