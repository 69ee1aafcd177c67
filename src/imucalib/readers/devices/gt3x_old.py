"""ActiGraph .gt3x of the first firmwares (NEO, MRA up to 2.5.0): info.txt and activity.bin.

activity.bin is one run of samples from the start date on: 12 bits a number in two's complement,
axes y x z, 341 counts a g. It has no stamps and no checksum but the archive's. Layout: ActiGraph,
"NHANES .gt3x File Format".
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.readers.devices.actigraph_archive import Archive, members_of
from imucalib.readers.devices.packets import Packets, packets_of, recordings, unpack_twelve_bits
from imucalib.readers.fields.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_DATA = "activity.bin"
_TICKS_TO_1970 = 621_355_968_000_000_000  # ticks of 100 ns from the year 1
_NO_DATE = 1 << 62  # ns: beyond every date
_PAIR, _PACKET = 9, 120  # bytes of two samples; samples that get a stamp


class OldGt3xReader(Joined):
    """The reader of ActiGraph's older archives."""

    name = "gt3x activity"
    suffixes = (".gt3x",)
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """A zip archive that holds activity.bin and info.txt, and no log.bin."""
        names = members_of(path, head)
        return {_DATA, "info.txt"} <= names and "log.bin" not in names

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks; an archive that breaks off gives what comes before."""
        archive = Archive(path, _DATA, strict=strict)
        try:
            start_ns = 100 * (int(archive.info["Start Date"]) - _TICKS_TO_1970)
        except (KeyError, ValueError):
            start_ns = _NO_DATE
        if abs(start_ns) >= _NO_DATE:
            raise UnreadableInput("info.txt states no start date", where=str(path))
        packets = _packets(archive, start_ns)
        yield from recordings(archive.log(self.name, packets), path, mapping, block_samples)


READER = OldGt3xReader()


def _packets(archive: Archive, start_ns: int) -> Iterator[Packets]:
    rest, passed, more = b"", 0, True
    pieces = archive.pieces()
    while more:
        piece = next(pieces, b"")
        data, more = rest + piece, bool(piece)
        used = len(data) // _PAIR * _PAIR if more else len(data)
        # A sample alone at the end fills four bytes and a half.
        numbers = unpack_twelve_bits(data[:used].ljust(-(-used // _PAIR) * _PAIR, b"\0")).reshape(
            -1, 3
        )
        counts, rest = numbers[: used * 2 // _PAIR, [1, 0, 2]], data[used:]
        first = np.arange(0, len(counts), _PACKET)
        yield packets_of(
            counts / archive.scale,
            stamp=start_ns + np.rint((passed + first) / archive.rate * 1e9).astype(np.int64),
            count=np.diff(first, append=len(counts)),
            rate=archive.rate,
        )
        passed += len(counts)
