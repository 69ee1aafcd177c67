"""ActiGraph .gt3x: a zip of info.txt (text) and log.bin (records of one second each).

A record is: 0x1E, type, time (u32, s since 1970 on the wearer's clock), size (u16), payload, and
the complement of the exclusive-or of all bytes before it. Acceleration is packed in 12 bits, axes
y x z (type 0), or in int16, axes x y z (type 26). Layout: ActiGraph's public GT3X file format.

The first firmwares (NEO, MRA up to 2.5.0) wrote activity.bin instead: one run of samples from the
start date on, 12 bits a number in two's complement, axes y x z, 341 counts a g, without stamps and
without a checksum but the archive's. Layout: ActiGraph, "NHANES .gt3x File Format".
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.readers.devices.actigraph_archive import Archive, members_of
from imucalib.readers.devices.packets import Packets, packets_of, recordings, unpack_twelve_bits
from imucalib.readers.fields.joining import Joined
from imucalib.readers.fields.source import head_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_RECORDS, _RUN = "log.bin", "activity.bin"
_PACKED, _WHOLE = 0, 26
_HEAD = struct.Struct("<BBIH")
_GROUP = 500  # seconds that are read at a time
_MOST_BAD = 100_000  # places that look like a record and are none
_TICKS_TO_1970 = 621_355_968_000_000_000  # ticks of 100 ns from the year 1
_NO_DATE = 1 << 62  # ns: beyond every date
_PAIR, _PACKET = 9, 120  # of a run: bytes of two samples; samples that get a stamp


class Gt3xReader(Joined):
    """The reader of ActiGraph's .gt3x files."""

    name = "gt3x"
    suffixes = (".gt3x",)
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """A zip archive, perhaps a cut one, that holds info.txt and samples."""
        names = members_of(path, head)
        return "info.txt" in names and not names.isdisjoint((_RECORDS, _RUN))

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks of whole seconds; seconds without samples (idle sleep) are gaps. An
        archive that breaks off gives what comes before."""
        names = members_of(path, head_of(path))
        if "info.txt" not in names:
            raise UnreadableInput(
                "this is no archive of an ActiGraph",
                where=str(path),
                remedy="copy it from the device again",
            )
        if _RECORDS in names:
            archive = Archive(path, _RECORDS, strict=strict)
            log = archive.log(self.name, _packets(archive))
        else:
            archive = Archive(path, _RUN, strict=strict)
            log = archive.log(f"{self.name} activity", _run_packets(archive, _start_of(archive)))
        yield from recordings(log, path, mapping, block_samples)


READER = Gt3xReader()


def _packets(archive: Archive) -> Iterator[Packets]:
    seconds = _seconds(archive)
    while group := list(islice(seconds, _GROUP)):
        counts = [some for _, some in group]
        yield packets_of(
            np.concatenate(counts) / archive.scale,
            stamp=np.array([stamp for stamp, _ in group]) * 1_000_000_000,
            count=np.array(list(map(len, counts))),
            rate=archive.rate,
        )


def _seconds(archive: Archive) -> Iterator[tuple[int, NDArray[np.int16]]]:
    """Stamps (s since 1970, wearer's clock) and raw counts (k, 3) of the records. A damaged one
    costs itself, and the walk goes on at the next mark."""
    stamp, passed, buffer, more = -1, 0, b"", True
    damaged, probes, late = 0, 0, list[int]()  # bytes, places, places
    pieces = archive.pieces()
    while more or len(buffer) >= 9:
        at, whole = 0, np.frombuffer(buffer, dtype=np.uint8)
        while at + 9 <= len(buffer):
            mark, kind, time, size = _HEAD.unpack_from(buffer, at)
            end = at + 8 + size
            if mark == 0x1E and end >= len(buffer) and more:
                break  # the rest of the record is in the next piece
            sound = mark == 0x1E and end < len(buffer)
            if sound and (int(np.bitwise_xor.reduce(whole[at:end])) ^ 0xFF) == buffer[end]:
                if kind in (_PACKED, _WHOLE) and size > 1:
                    if time > stamp:
                        stamp = time
                        yield time, _counts(buffer[at + 8 : end], kind)
                    else:
                        what = "the stamp of a record is not later than the one before"
                        archive.refuse(what, passed + at)
                        late.append(passed + at)
                at = end + 1
                continue
            archive.refuse("a record is damaged", passed + at)
            probes += 1
            if probes > _MOST_BAD:
                raise UnreadableInput("log.bin holds no records", where=str(archive.path))
            following = buffer.find(b"\x1e", at + 1)
            following = following if following >= 0 else len(buffer)
            damaged, at = damaged + following - at, following
        piece = next(pieces, b"")
        more = bool(piece)
        passed, buffer = passed + at, buffer[at:] + piece
    damaged += len(buffer)
    if damaged:
        archive.lost.append(f"{damaged} damaged bytes of log.bin were left out")
    if late:
        archive.lost.append(
            f"{len(late)} records whose stamp is not later than the one before were left out, "
            f"the first at byte {late[0]} of log.bin"
        )


def _counts(payload: bytes, kind: int) -> NDArray[np.int16]:
    """(k, 3) counts, axes x y z; an odd rest is left out."""
    if kind == _WHOLE:
        return np.frombuffer(payload[: len(payload) // 6 * 6], "<i2").reshape(-1, 3)
    return unpack_twelve_bits(payload[: len(payload) // 9 * 9]).reshape(-1, 3)[:, [1, 0, 2]]


def _start_of(archive: Archive) -> int:
    """ns since 1970 of a run's first sample."""
    try:
        start_ns = 100 * (int(archive.info["Start Date"]) - _TICKS_TO_1970)
    except (KeyError, ValueError):
        start_ns = _NO_DATE
    if abs(start_ns) >= _NO_DATE:
        raise UnreadableInput("info.txt states no start date", where=str(archive.path))
    return start_ns


def _run_packets(archive: Archive, start_ns: int) -> Iterator[Packets]:
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
