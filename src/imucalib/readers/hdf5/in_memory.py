"""Files whose numbers have to be held in memory anyway, read as an HDF5 file with those numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from imucalib.arrays import Array
from imucalib.readers.hdf5.file import File
from imucalib.readers.hdf5.reader import blocks_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording


def blocks_in_memory(
    fill: Callable[[Any], None],
    path: Path,
    mapping: FieldMapping,
    *,
    block_samples: int,
    strict: bool,
    name: str,
    notes: tuple[str, ...] = (),
) -> Iterator[Recording]:
    """Blocks of what `fill` puts into an HDF5 file that is nowhere but in memory.

    name : of the format that the numbers came from; notes : what was lost there, for the first
    block
    """
    import h5py

    with h5py.File(f"{path.name}-in-memory", "w", driver="core", backing_store=False) as held:
        fill(held)
        file = File(held, str(path), strict)
        for block in blocks_of(file, path, mapping, block_samples):
            yield replace(block, format=name, notes=(*notes, *block.notes))
            notes = ()


def put_channel(held: Any, name: str, seconds: Array, values: Array, units: str) -> None:
    """One channel, "imu0/acceleration", with its own clock in s and its stated unit."""
    group = held.create_group(name)
    group.create_dataset("time", data=seconds).attrs["units"] = "s"
    group.create_dataset("values", data=values).attrs["units"] = units
