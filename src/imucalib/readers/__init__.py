"""Recording formats: each module of this folder that has a `READER` reads one format.

A reader is found by its file being here, or by an entry point of the group "imucal.readers" of a
package that is installed; `read` picks the one that recognises the input.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol

import numpy as np

from imucalib.core.discovery import modules_of
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.devices.catalogue import refuse_foreign, with_preset
from imucalib.readers.fields.joining import (
    check_clocks,
    in_parts,
    join_files,
)
from imucalib.readers.fields.rates import check_rates
from imucalib.readers.fields.source import UNREAD, file_kind, head_of
from imucalib.readers.fields.unmeasured import drop_impossible, mark_held
from imucalib.recording.mapping import TIME_ZEROS, FieldMapping
from imucalib.recording.recording import Recording
from imucalib.recording.sensors import select_sensor

__all__ = [
    "BLOCK_SAMPLES",
    "Reader",
    "blocks",
    "blocks_again",
    "read",
    "read_together",
    "reader_for",
    "readers",
]

BLOCK_SAMPLES = 1 << 18  #: default samples (rows) of a block


class Reader(Protocol):
    """One recording format. Memory of `blocks` is bounded by the block, not by the file.

    Rules that hold for every reader and are tested on all of them:
    - `recognises` looks at the content (`head` is the first 64 KiB, empty for the folder
      of a ROS 2 bag), never at the suffix alone;
    - times `t` of all blocks count from the same `start_ns`, and each block holds consecutive
      samples, so that concatenating the blocks equals `read`; a block may lack a channel;
    - times that step back by more than a second have a gap that ends before it starts: `in_parts`
      makes parts of them;
    - a note or gap appears in one block only: the first in which it is known (a gap between two
      blocks belongs to the later one);
    - units are SI, or "counts" when raw integers were declared without a scale;
    - damage gives what is readable and a note; with `strict` it raises UnreadableInput;
    - nothing but an ImucalError leaves a reader.
    """

    @property
    def name(self) -> str:
        """Short name of the format, stored in `Recording.format`."""
        ...

    @property
    def suffixes(self) -> tuple[str, ...]:
        """Lower-case file name endings that this format usually has, with the dot."""
        ...

    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether the content is of this format."""
        ...

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Yield the recording in time order, in blocks of about `block_samples` samples."""
        ...

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read the whole recording."""
        ...


@cache
def readers() -> tuple[Reader, ...]:
    """Every reader of this folder, in the order of their names, then those of other packages.

    An entry point of the group "imucal.readers" names an object like `READER` here.
    """
    own = (m.READER for m in modules_of(__name__) if hasattr(m, "READER"))
    return (*own, *(point.load() for point in entry_points(group="imucal.readers")))


def reader_for(path: str | os.PathLike[str]) -> Reader:
    """The reader for a file: by content first, then by a suffix that one format alone has;
    UnreadableInput when none fits."""
    file = Path(path)
    head = b"" if os.path.isfile(file / "metadata.yaml") else head_of(file)
    refuse_foreign(file, head)
    for reader in readers():
        if reader.recognises(file, head):
            return reader
    by_suffix = [reader for reader in readers() if file.name.lower().endswith(reader.suffixes)]
    if len(by_suffix) == 1:
        return by_suffix[0]
    kind = file_kind(head, UNREAD)
    if kind is not None:
        raise UnreadableInput(f"this is {kind.name}", where=str(path), remedy=kind.remedy)
    formats = ", ".join(f"{r.name} ({' '.join(r.suffixes)})" for r in readers())
    raise UnreadableInput(
        f"the format is not known; the file starts with the bytes {head[:8].hex(' ')}",
        where=str(path),
        remedy=f"readable formats: {formats}",
    )


def read(
    path: str | os.PathLike[str], mapping: FieldMapping | None = None, *, strict: bool = False
) -> Recording:
    """Read a whole recording of any known format.

    Units are SI. What was detected, repaired or lost is in `Recording.notes`. Raises
    UnreadableInput when nothing can be read or, with `strict`, when anything is damaged, and
    UsageError when the mapping names what the file does not have.
    """
    full = with_preset(mapping or FieldMapping())
    reader = _reader(path, full)
    found = (reader.read(Path(path), full, strict=strict) for _ in range(1))
    return next(_guard(_look_at(found, full, reader), path))


def read_together(
    paths: Sequence[str | os.PathLike[str]],
    mapping: FieldMapping | None = None,
    *,
    strict: bool = False,
) -> Recording:
    """Files of one device, each of other sensors, as one recording (a phone's accelerometer and
    gyroscope). Errors as in `read`, and UsageError for clocks that do not fit each other."""
    return join_files([read(path, mapping, strict=strict) for path in paths])


def blocks(
    path: str | os.PathLike[str],
    mapping: FieldMapping | None = None,
    *,
    block_samples: int = BLOCK_SAMPLES,
    strict: bool = False,
) -> Iterator[Recording]:
    """Read a recording of any known format piecewise, in bounded memory; errors as in `read`."""
    full = with_preset(mapping or FieldMapping())
    reader = _reader(path, full)
    found = reader.blocks(Path(path), full, block_samples=block_samples, strict=strict)
    return _guard(_look_at(found, full, reader), path)


def blocks_again(
    path: str | os.PathLike[str], mapping: FieldMapping, channel: str
) -> Iterator[Recording]:
    """One channel of a recording that `blocks` has gone through: neither repeats nor units are
    looked at anew."""
    full = with_preset(mapping)
    reader = _reader(path, full)
    found = reader.blocks(Path(path), full, block_samples=BLOCK_SAMPLES, strict=False)
    found = select_sensor(found, full.sensor) if full.sensor else found
    one = (
        replace(b, channels={k: c for k, c in b.channels.items() if k == channel}) for b in found
    )
    return _guard(in_parts(drop_impossible(one)), path)


def _reader(path: str | os.PathLike[str], mapping: FieldMapping) -> Reader:
    """The reader for a file. Raises UsageError for what only tables and HDF5 files have."""
    reader = reader_for(path)
    if mapping.where and reader.name != "csv":
        raise UsageError(
            f"--where selects rows of text tables, and this is {reader.name}",
            where=str(path),
            remedy="leave it out",
        )
    if mapping.time_unit in TIME_ZEROS and reader.name not in ("csv", "hdf5", "matlab"):
        raise UsageError(
            f"stamps of {reader.name} count from 1970 or from a start, not in {mapping.time_unit}",
            where=str(path),
            remedy="give --time-unit s, ms, us or ns",
        )
    return reader


def _look_at(
    found: Iterator[Recording], mapping: FieldMapping, reader: Reader
) -> Iterator[Recording]:
    """What holds for every format: the sensor that is wanted, a clock's parts, clocks that such
    sensors can have, rates in the unit that is stated, and samples that are no measurement."""
    fixed = getattr(reader, "fixed", False)
    found = select_sensor(found, mapping.sensor) if mapping.sensor else found
    possible = drop_impossible(found)
    clocked = check_clocks(in_parts(possible))
    return mark_held(check_rates(clocked, mapping, fixed=fixed))


def _guard(found: Iterator[Recording], path: str | os.PathLike[str]) -> Iterator[Recording]:
    """The same; a damaged number, of any size or a signalling NaN, is no warning of numpy's. Raises
    UnreadableInput where the operating system cannot read the file."""
    while True:
        try:
            with np.errstate(invalid="ignore", over="ignore"):
                one = next(found, None)
        except OSError as error:
            detail = error.strerror or str(error) or type(error).__name__
            raise UnreadableInput(
                f"the file cannot be read: {detail}",
                where=str(path),
                remedy="check the disk or share",
            ) from error
        if one is None:
            return
        yield one
