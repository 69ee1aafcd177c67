"""ActiGraph's archives: a zip of info.txt, text with a "name: value" a line, and of the samples.

What is damaged in one, and how it is told. An archive that was cut has lost the directory at its
end; every member begins with a header of its own, by which it is found and unpacked then (PKWARE,
APPNOTE.TXT, 4.3.7). Layout: ActiGraph's public GT3X file format.
"""

from __future__ import annotations

import mmap
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Protocol

import numpy as np

from imucalib.errors import UnreadableInput
from imucalib.readers.source import small_directory

#: What a damaged archive raises, depending on where the damage is.
DAMAGED = (
    zipfile.BadZipFile,
    zlib.error,
    KeyError,
    EOFError,
    OSError,
    ValueError,
    NotImplementedError,
    RuntimeError,
    struct.error,
)
_MOST_RATE = 10_000.0  # Hz
_PIECE = 1 << 16  # bytes: what a checksum that fails at the end may cost
#: What no device writes: a longer info.txt, a large log that packs better than this.
_INFO_BYTES, _LARGE, _RATIO = 1 << 20, 16 << 20, 100
#: A member's header, and what follows one whose size and checksum were not known when it was
#: written (flag 8); its size then; members at most; and packed bytes that are unpacked at a time.
_LOCAL, _LOCAL_HEADER, _DESCRIPTOR = b"PK\x03\x04", struct.Struct("<6xHH4xII4xHH"), b"PK\x07\x08"
_NO_SIZE, _MOST_MEMBERS, _PACKED = 0xFFFF_FFFF, 1000, 1 << 12


@dataclass
class Loss:
    """damaged : bytes of log.bin in no sound record; late : records whose stamp is not later than
    the one before; broken : why the archive ends too early
    """

    where: str
    strict: bool
    damaged: int = 0
    late: int = 0
    first_late: int = 0
    broken: str = ""
    told: tuple[str, ...] = ()

    def refuse(self, what: str, at: int) -> None:
        """Raise UnreadableInput where a damaged file is not wanted."""
        if self.strict:
            raise UnreadableInput(what, where=f"{self.where}, byte {at} of log.bin")

    def not_later(self, at: int) -> None:
        """Count a record that the clock does not place; raises with `strict`."""
        self.refuse("the stamp of a record is not later than the one before", at)
        self.late, self.first_late = self.late + 1, self.first_late if self.late else at

    def tell(self) -> None:
        """Put the sentences that the recording carries into `told`, when all has been read."""
        late = f"{self.late} records whose stamp is not later than the one before were left out, "
        self.told = (
            *(f"{self.damaged} damaged bytes of log.bin were left out",) * bool(self.damaged),
            *(f"{late}the first at byte {self.first_late} of log.bin",) * bool(self.late),
            *(self.broken,) * bool(self.broken),
        )


@dataclass(frozen=True)
class _Member:
    """A member by its own header: where its bytes begin, how many they are when packed (None:
    unknown), whether they are deflated, and their checksum (None: it follows them)."""

    at: int
    packed: int | None
    deflated: bool
    crc: int | None


def _by_headers(path: Path) -> dict[str, _Member]:
    """Members of an archive without a directory, by name; the first of a name counts."""
    found: dict[str, _Member] = {}
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as raw:
        at = 0
        while len(found) < _MOST_MEMBERS and (at := raw.find(_LOCAL, at)) >= 0:
            if at + 30 > len(raw):
                break
            flags, method, crc, packed, name, extra = _LOCAL_HEADER.unpack(raw[at : at + 30])
            begin, text = at + 30 + name + extra, raw[at + 30 : at + 30 + name]
            if method in (0, 8) and text and text.isascii() and text.decode("ascii").isprintable():
                later = bool(flags & 8) and not crc
                size = None if packed == _NO_SIZE or (later and not packed) else packed
                one = _Member(begin, size, method == 8, None if later else crc)
                found.setdefault(text.decode("ascii"), one)
                at = begin + (size or 0)
            else:
                at += len(_LOCAL)
    return found


class Unpacked(Protocol):
    """Bytes of a member."""

    def read(self, size: int, /) -> bytes:
        """The next bytes, at most `size`; none at the end."""
        ...


@contextmanager
def member(path: Path, name: str) -> Iterator[Unpacked]:
    """A member of an archive, unpacked while it is read, with its directory or without.

    Raises what `DAMAGED` holds, and where it breaks off only behind all that comes before.
    """
    if _sound(path):
        with zipfile.ZipFile(path) as archive, archive.open(name) as stream:
            yield stream
        return
    found = _by_headers(path)[name]
    with path.open("rb") as raw:
        raw.seek(found.at)
        yield _Alone(raw, found)


class _Alone:
    """A member without a directory, up to its own end. Behind all that comes before, raises
    EOFError where that end is missing and BadZipFile where the checksum is another."""

    def __init__(self, raw: IO[bytes], found: _Member) -> None:
        self._raw, self._found, self._unpacker = raw, found, zlib.decompressobj(-15)
        self._left, self._crc = found.packed, 0
        self._fault: Exception | None = None

    def read(self, size: int, /) -> bytes:
        """The next bytes, at most `size`; none at the end."""
        whole = self._inflated(size) if self._found.deflated else self._stored(size)
        self._crc = zlib.crc32(whole, self._crc)
        if not whole and self._fault is None and self._stated() not in (None, self._crc):
            self._fault = zipfile.BadZipFile("its checksum differs")
        if not whole and self._fault is not None:
            raise self._fault
        return whole

    def _inflated(self, size: int) -> bytes:
        parts, held = list[bytes](), 0
        while held < size and not self._unpacker.eof and self._fault is None:
            try:
                piece = self._unpacker.unconsumed_tail or self._raw.read(_PACKED)
                data = self._unpacker.decompress(piece, size - held)
                if not piece:
                    self._fault = EOFError("the archive ends within it")
            except zlib.error as error:
                self._fault, data = error, b""
            parts.append(data)
            held += len(data)
        return b"".join(parts)

    def _stored(self, size: int) -> bytes:
        data = self._raw.read(size if self._left is None else min(size, self._left))
        self._left = None if self._left is None else self._left - len(data)
        if self._left and not data:
            self._fault = EOFError("the archive ends within it")
        return data

    def _stated(self) -> int | None:
        """The checksum of the header, or of what follows; None where that is cut off."""
        if self._found.crc is not None:
            return self._found.crc
        after = (self._unpacker.unused_data + self._raw.read(8)).removeprefix(_DESCRIPTOR)
        return int.from_bytes(after[:4], "little") if len(after) >= 4 else None


def _sound(path: Path) -> bool:
    """Whether the archive has a directory of usual size that can be read."""
    try:
        if not small_directory(path):
            return False
        with zipfile.ZipFile(path):
            return True
    except DAMAGED:
        return False


def without_directory(path: Path, *, strict: bool) -> str:
    """What to tell of an archive that has lost its directory, empty of a sound one; raises
    UnreadableInput with `strict`."""
    if _sound(path):
        return ""
    if strict:
        raise UnreadableInput("the archive has no directory", where=str(path))
    return "the archive has lost its directory: its members were found without"


def members_of(path: Path, head: bytes) -> frozenset[str]:
    """Names of an archive's members, with its directory or without; none where the head is no
    archive's."""
    if not head.startswith(_LOCAL):
        return frozenset()
    if not _sound(path):
        return frozenset(_by_headers(path))
    with zipfile.ZipFile(path) as archive:
        return frozenset(archive.namelist())


def info_of(path: Path, data: str) -> dict[str, str]:
    """The lines of info.txt by name; `data` is the member that holds the samples.

    Raises UnreadableInput for a damaged archive and for what no device writes.
    """
    try:
        with member(path, "info.txt") as stream:
            raw = stream.read(_INFO_BYTES + 1)
            raw += stream.read(1)  # the end, where the checksum is seen
        if _sound(path):
            with zipfile.ZipFile(path) as archive:
                log = archive.getinfo(data)
                size, packed = log.file_size, log.compress_size
        else:
            size, packed = 0, 0  # it is counted while it is unpacked
    except DAMAGED as error:
        remedy = "copy it from the device again"
        raise UnreadableInput(
            f"the archive cannot be opened: {error}", where=str(path), remedy=remedy
        ) from None
    if len(raw) > _INFO_BYTES:
        raise UnreadableInput(f"info.txt is longer than {_INFO_BYTES} bytes", where=str(path))
    if size > max(_LARGE, _RATIO * packed):
        what = f"{data} claims {size} bytes in {packed}: no recording is so even"
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


def pieces_of(path: Path, loss: Loss) -> Iterator[bytes]:
    """log.bin piece by piece; what a damaged archive still gives.

    A failure ends the pieces, and the one that was on its way is lost.
    """
    passed = 0
    try:
        loss.broken = without_directory(path, strict=loss.strict)
        with member(path, "log.bin") as log:
            while piece := log.read(_PIECE):
                passed += len(piece)
                yield piece
    except DAMAGED as error:
        loss.refuse(f"the archive breaks off: {error}", passed)
        loss.broken = f"log.bin breaks off after {passed} bytes: {error}"
