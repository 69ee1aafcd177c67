"""ActiGraph .gt3x: a zip of info.txt (text) and log.bin (records of one second each).

A record is: 0x1E, type, time (u32, s since 1970 on the wearer's clock), size (u16), payload, and
the complement of the exclusive-or of all bytes before it. Acceleration is packed in 12 bits, axes
y x z (type 0), or in int16, axes x y z (type 26). Layout: ActiGraph's public GT3X file format.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.readers.conversion import Source, acceleration, readings_at_rest
from imucalib.readers.devices.actigraph_archive import (
    Loss,
    facts_of,
    info_of,
    members_of,
    pieces_of,
)
from imucalib.readers.joining import Joined
from imucalib.readers.source import sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

_PACKED, _WHOLE = 0, 26
_HEAD = struct.Struct("<BBIH")
_MOST_BAD = 100_000  # places that look like a record and are none


@dataclass(frozen=True)
class _Second:
    """The samples of one second: stamp (s since 1970, wearer's clock) and raw counts (k, 3)."""

    stamp: int
    counts: NDArray[np.int16]


class Gt3xReader(Joined):
    """The reader of ActiGraph's .gt3x files."""

    name = "gt3x"
    suffixes = (".gt3x",)
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """A zip archive, perhaps a cut one, that holds log.bin and info.txt."""
        return {"log.bin", "info.txt"} <= members_of(path, head)

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks of whole seconds; seconds without samples are gaps (idle sleep)."""
        info = info_of(path, "log.bin")
        rate, scale, zone = facts_of(info, str(path))
        digest, origin, conversion, before = sha256_of(path), None, None, None
        loss = Loss(str(path), strict)
        for seconds in _grouped(_seconds(path, loss), block_samples):
            counts = np.concatenate([s.counts for s in seconds]) / scale
            notes: list[str] = []
            if origin is None or conversion is None:
                origin = seconds[0].stamp
                rest = readings_at_rest([counts], round(rate))
                conversion = acceleration(mapping, Source("g", fixed=True), rest, str(path))
                serial = info.get("Serial Number", "of unknown number")
                notes.append(f"ActiGraph {serial}, {rate:g} Hz, {scale:g} counts a g")
                notes += [conversion.note] * bool(conversion.note)
                if zone is None:
                    notes.append("the time zone is not in the file: times are the wearer's")
            t = np.concatenate(
                [s.stamp - origin + np.arange(len(s.counts)) / rate for s in seconds]
            )
            gaps = _gaps(seconds, origin, before)
            before = seconds[-1].stamp
            values = conversion.apply(counts)
            channel = Channel(t, values, conversion.unit, "acceleration", "imu0", rate)
            yield Recording(
                channels={"imu0/acceleration": channel},
                path=str(path),
                format=self.name,
                sha256=digest,
                start_ns=(origin - (zone or 0)) * 1_000_000_000,
                gaps=gaps,
                notes=(*notes, *loss.told),
                mapping={"acc_unit": conversion.source_unit, "rate": rate},
            )
        if origin is None:
            what = "; ".join(["no samples in it", *loss.told])
            raise UnreadableInput(what, where=str(path), remedy="copy it from the device again")


READER = Gt3xReader()


def _seconds(path: Path, loss: Loss) -> Iterator[_Second]:
    """Walk the records; a damaged one costs itself, and the walk goes on at the next mark."""
    probes, stamp, passed, buffer = 0, -1, 0, b""
    pieces = pieces_of(path, loss)
    more = True
    while more or len(buffer) >= 9:
        at = 0
        whole = np.frombuffer(buffer, dtype=np.uint8)
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
                        yield _Second(time, _counts(buffer[at + 8 : end], kind))
                    else:
                        loss.not_later(passed + at)
                at = end + 1
                continue
            loss.refuse("a record is damaged", passed + at)
            probes += 1
            if probes > _MOST_BAD:
                raise UnreadableInput("log.bin holds no records", where=str(path))
            following = buffer.find(b"\x1e", at + 1)
            following = following if following >= 0 else len(buffer)
            loss.damaged, at = loss.damaged + following - at, following
        piece = next(pieces, b"")
        more = bool(piece)
        passed, buffer = passed + at, buffer[at:] + piece
    loss.damaged += len(buffer)
    loss.tell()


def _counts(payload: bytes, kind: int) -> NDArray[np.int16]:
    """(k, 3) counts, axes x y z."""
    if kind == _WHOLE:
        return np.frombuffer(payload[: len(payload) // 6 * 6], "<i2").reshape(-1, 3)
    return unpacked(payload)


def unpacked(payload: bytes) -> NDArray[np.int16]:
    """(k, 3) counts, axes x y z, of 12-bit numbers in the order y x z; an odd rest is left out."""
    raw = np.frombuffer(payload[: len(payload) // 9 * 9], np.uint8).reshape(-1, 3).astype(np.int16)
    numbers = np.empty((raw.shape[0], 2), np.int16)
    numbers[:, 0] = raw[:, 0] << 4 | raw[:, 1] >> 4
    numbers[:, 1] = (raw[:, 1] & 15) << 8 | raw[:, 2]
    signed = np.where(numbers > 2047, numbers - 4096, numbers)
    return signed.reshape(-1, 3)[:, [1, 0, 2]].astype(np.int16)


def _grouped(seconds: Iterator[_Second], samples: int) -> Iterator[list[_Second]]:
    group: list[_Second] = []
    held = 0
    for second in seconds:
        if held >= samples:  # not before more is there: the last group comes when all is told
            yield group
            group, held = [], 0
        group.append(second)
        held += len(second.counts)
    if group:
        yield group


def _gaps(seconds: list[_Second], origin: int, before: int | None) -> tuple[Gap, ...]:
    stamps = np.array(([before] if before is not None else []) + [s.stamp for s in seconds])
    breaks = np.flatnonzero(np.diff(stamps) > 1)
    return tuple(
        Gap(
            float(stamps[k] + 1 - origin), float(stamps[k + 1] - origin), "idle sleep or no samples"
        )
        for k in breaks
    )
