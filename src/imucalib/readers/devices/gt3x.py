"""ActiGraph .gt3x: a zip of info.txt (text) and log.bin (records of one second each).

A record is: 0x1E, type, time (u32, s since 1970 on the wearer's clock), size (u16), payload, and
the complement of the exclusive-or of all bytes before it. Acceleration is packed in 12 bits, axes
y x z (type 0), or in int16, axes x y z (type 26). Layout: ActiGraph's public GT3X file format.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.readers.conversion import acceleration, norms_at_rest
from imucalib.readers.joining import join
from imucalib.readers.source import sha256_of
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

_PACKED, _WHOLE = 0, 26
#: What a damaged archive raises, depending on where the damage is.
DAMAGED = (
    zipfile.BadZipFile, zlib.error, KeyError, EOFError, OSError, ValueError, NotImplementedError,
    RuntimeError, struct.error,
)  # fmt: skip
_HEAD = struct.Struct("<BBIH")
_MOST_RATE = 10_000.0  # Hz
#: What no device writes: a longer info.txt, a large log that packs better than this, more places
#: that look like a record and are none.
_INFO_BYTES, _LARGE, _RATIO, _MOST_BAD = 1 << 20, 16 << 20, 100, 100_000


@dataclass(frozen=True)
class _Second:
    """The samples of one second: stamp (s since 1970, wearer's clock) and raw counts (k, 3)."""

    stamp: int
    counts: NDArray[np.int16]


class Gt3xReader:
    """The reader of ActiGraph's .gt3x files."""

    name = "gt3x"
    suffixes = (".gt3x",)

    def recognises(self, path: Path, head: bytes) -> bool:
        """A zip archive that holds log.bin and info.txt."""
        if not head.startswith(b"PK\x03\x04"):
            return False
        try:
            with zipfile.ZipFile(path) as archive:
                return {"log.bin", "info.txt"} <= set(archive.namelist())
        except DAMAGED:
            return path.suffix.lower() == ".gt3x"

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read all samples."""
        return join(self.blocks(path, mapping, block_samples=1 << 18, strict=strict), str(path))

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks of whole seconds; seconds without samples are gaps (idle sleep)."""
        info = info_of(path, "log.bin")
        rate, scale, zone = facts_of(info, str(path))
        digest, origin, conversion, before = sha256_of(path), None, None, None
        lost: list[str] = []
        for seconds in _grouped(_seconds(path, strict, lost), block_samples):
            counts = np.concatenate([s.counts for s in seconds]) / scale
            notes: list[str] = []
            if origin is None or conversion is None:
                origin = seconds[0].stamp
                rest = norms_at_rest([counts], round(rate))
                conversion = acceleration(mapping, "g", rest, str(path))
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
                notes=(*notes, *lost),
                mapping={"acc_unit": conversion.source_unit, "rate": rate},
            )


READER = Gt3xReader()


def info_of(path: Path, data: str) -> dict[str, str]:
    """The lines of info.txt by name; `data` is the member that holds the samples.

    Raises UnreadableInput for a damaged archive and for what no device writes.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            with archive.open("info.txt") as stream:
                raw = stream.read(_INFO_BYTES + 1)
            log = archive.getinfo(data)
    except DAMAGED as error:
        remedy = "copy it from the device again"
        raise UnreadableInput(
            f"the archive cannot be opened: {error}", where=str(path), remedy=remedy
        ) from None
    if len(raw) > _INFO_BYTES:
        raise UnreadableInput(f"info.txt is longer than {_INFO_BYTES} bytes", where=str(path))
    if log.file_size > max(_LARGE, _RATIO * log.compress_size):
        what = (
            f"{data} claims {log.file_size} bytes in {log.compress_size}: no recording is so even"
        )
        raise UnreadableInput(what, where=str(path))
    text = raw.decode("utf-8-sig", errors="replace")
    pairs = (line.split(": ", 1) for line in text.splitlines() if ": " in line)
    return {name.strip(): value.strip() for name, value in pairs}


def facts_of(info: dict[str, str], where: str) -> tuple[float, float, int | None]:
    """Sample rate (Hz), counts a g, and the zone's offset from UTC (s)."""
    try:
        rate = float(info["Sample Rate"].replace(",", "."))
        scale = float(info.get("Acceleration Scale", "").replace(",", ".") or 341.0)
    except (KeyError, ValueError):
        raise UnreadableInput("info.txt states no sample rate or scale", where=where) from None
    if not (0.0 < rate <= _MOST_RATE and 0.0 < scale < np.inf):
        raise UnreadableInput(f"sample rate {rate:g} and scale {scale:g}", where=where)
    zone = info.get("TimeZone", "")
    try:
        hours, minutes, seconds = zone.lstrip("+-").split(":")
        size = 3600 * int(hours) + 60 * int(minutes) + int(seconds)
    except ValueError:
        return rate, scale, None
    return rate, scale, -size if zone.startswith("-") else size


def _seconds(path: Path, strict: bool, lost: list[str]) -> Iterator[_Second]:
    """Walk the records; a damaged one costs itself, and the walk goes on at the next mark."""
    bad, probes, stamp, passed, buffer = 0, 0, -1, 0, b""
    pieces = _pieces(path)
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
                if kind in (_PACKED, _WHOLE) and size > 1 and time > stamp:
                    stamp = time
                    yield _Second(time, _counts(buffer[at + 8 : end], kind))
                at = end + 1
                continue
            if strict:
                where = f"{path}, byte {passed + at} of log.bin"
                raise UnreadableInput("a record is damaged", where=where)
            probes += 1
            if probes > _MOST_BAD:
                raise UnreadableInput("log.bin holds no records", where=str(path))
            following = buffer.find(b"\x1e", at + 1)
            following = following if following >= 0 else len(buffer)
            bad, at = bad + following - at, following
        piece = next(pieces, b"")
        more = bool(piece)
        passed, buffer = passed + at, buffer[at:] + piece
    bad += len(buffer)
    if bad:
        lost.append(f"{bad} damaged bytes of log.bin were left out")


def _pieces(path: Path) -> Iterator[bytes]:
    """log.bin, a megabyte at a time; what a damaged archive still gives.

    A failure ends the pieces: the archive's checksum is over all, the records have their own.
    """
    try:
        with zipfile.ZipFile(path) as archive, archive.open("log.bin") as log:
            while piece := log.read(1 << 20):
                yield piece
    except DAMAGED:
        return


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
        group.append(second)
        held += len(second.counts)
        if held >= samples:
            yield group
            group, held = [], 0
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
