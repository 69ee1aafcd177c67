"""ActiGraph .gt3x of the first firmwares (NEO, MRA up to 2.5.0): info.txt and activity.bin.

activity.bin is one run of samples from the start date on: 12 bits a number in two's complement,
axes y x z, 341 counts a g. It has no stamps and no checksum but the archive's. Layout: ActiGraph,
"NHANES .gt3x File Format".
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.actigraph_archive import (
    DAMAGED,
    facts_of,
    info_of,
    member,
    members_of,
    without_directory,
)
from imucalib.readers.devices.gt3x import unpacked
from imucalib.readers.devices.packets import Log, Packets, recordings
from imucalib.readers.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_DATA = "activity.bin"
_TICKS_TO_1970 = 621_355_968_000_000_000  # ticks of 100 ns from the year 1
_NO_DATE = 1 << 62  # ns: beyond every date
_PAIR = 9  # bytes of two samples


@dataclass(frozen=True)
class _Start:
    """stamp : ns since 1970 on the wearer's clock; rate : Hz; scale : counts a g"""

    stamp: int
    rate: float
    scale: float


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
        info = info_of(path, _DATA)
        rate, scale, zone = facts_of(info, str(path))
        try:
            start_ns = 100 * (int(info["Start Date"]) - _TICKS_TO_1970)
        except (KeyError, ValueError):
            start_ns = _NO_DATE
        if abs(start_ns) >= _NO_DATE:
            raise UnreadableInput("info.txt states no start date", where=str(path))
        lost = [note] if (note := without_directory(path, strict=strict)) else []
        start = _Start(start_ns, rate, scale)
        packets = _packets(path, start, block_samples, lost=lost, strict=strict)
        serial = info.get("Serial Number", "of unknown number")
        notes = [f"ActiGraph {serial}, {rate:g} Hz, {scale:g} counts a g"]
        if zone is None:
            notes.append("the time zone is not in the file: times are the wearer's")
        log = Log(self.name, packets, tuple(notes), lost, 0.0, zone or 0)
        yield from recordings(log, path, mapping)


READER = OldGt3xReader()


def _packets(
    path: Path, start: _Start, samples: int, *, lost: list[str], strict: bool
) -> Iterator[Packets]:
    passed, rest, more = 0, b"", True
    try:
        with member(path, _DATA) as stream:
            while more:
                piece = stream.read(_PAIR * max(1, samples // 2))
                more, data = bool(piece), rest + piece
                whole = len(data) // _PAIR * _PAIR
                # A sample alone at the end fills four bytes and a half.
                used = whole if more else len(data)
                counts = unpacked(data[:used].ljust(-(-used // _PAIR) * _PAIR, b"\0"))
                counts, rest = counts[: used * 2 // _PAIR], data[used:]
                if counts.size:
                    yield _packet(counts / start.scale, start, passed)
                passed += counts.shape[0]
    except DAMAGED as error:
        what = f"activity.bin breaks off after {passed} samples: {error}"
        if strict:
            raise UnreadableInput(what, where=str(path)) from None
        lost.append(what)


def _packet(acc: Array, start: _Start, passed: int) -> Packets:
    stamp = start.stamp + round(passed / start.rate * 1e9)
    return Packets(
        stamp=np.array([stamp]),
        at=np.zeros(1, np.int64),
        count=np.array([acc.shape[0]]),
        rate=np.array([start.rate]),
        warm=np.array([np.nan]),
        acc=acc,
        gyro=np.full(acc.shape, np.nan),
    )
