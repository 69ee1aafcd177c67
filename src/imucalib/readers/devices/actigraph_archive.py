"""ActiGraph's archives: a zip of info.txt, text with a "name: value" a line, and of the samples.

An archive that was cut has lost the directory at its end; every member begins with a header of its
own, by which it is found and unpacked then (PKWARE, APPNOTE.TXT, 4.3.7). Layout: ActiGraph's public
GT3X file format.
"""

from __future__ import annotations

import mmap
import struct
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from imucalib.errors import UnreadableInput
from imucalib.readers.devices.packets import Log, Packets, zone_of
from imucalib.readers.fields.source import small_directory

#: What a damaged archive raises, depending on where the damage is.
_DAMAGED = (
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


def members_of(path: Path, head: bytes) -> frozenset[str]:
    """Names of an archive's members, with its directory or without; none where the head is no
    archive's."""
    if not head.startswith(_LOCAL):
        return frozenset()
    if not _sound(path):
        return frozenset(_by_headers(path))
    with zipfile.ZipFile(path) as archive:
        return frozenset(archive.namelist())


class Archive:
    """An archive, and what its info.txt says.

    rate : Hz; scale : counts a g; lost : sentences on what was damaged, filled meanwhile
    Raises UnreadableInput for a damaged info.txt and for what no device writes; with `strict` for
    any damage.
    """

    def __init__(self, path: Path, data: str, *, strict: bool) -> None:
        self.path, self.strict, self.lost = path, strict, list[str]()
        self._data = data  # the member that holds the samples
        self._whole = _sound(path)
        try:
            raw = b""
            for piece in self._pieces("info.txt"):
                raw += piece
                if len(raw) > _INFO_BYTES:
                    what = f"info.txt is longer than {_INFO_BYTES} bytes"
                    raise UnreadableInput(what, where=str(path))
            if self._whole:
                self._demand_likely()
        except _DAMAGED as error:
            raise UnreadableInput(
                f"the archive cannot be opened: {error}",
                where=str(path),
                remedy="copy it from the device again",
            ) from None
        lines = raw.decode("utf-8-sig", errors="replace").splitlines()
        pairs = (line.split(": ", 1) for line in lines if ": " in line)
        self.info = {name.strip(): value.strip() for name, value in pairs}
        self.rate, self.scale = self._facts()
        if not self._whole:
            if strict:
                raise UnreadableInput("the archive has no directory", where=str(path))
            self.lost.append("the archive has lost its directory: its members were found without")

    def log(self, name: str, packets: Iterator[Packets]) -> Log:
        """The packets of a format with what info.txt says."""
        serial, zone = self.info.get("Serial Number", ""), zone_of(self.info.get("TimeZone", ""))
        known = f"{serial or 'of unknown number'}, {self.rate:g} Hz"
        notes = [f"ActiGraph {known}, {self.scale:g} counts a g"]
        if zone is None:
            notes.append("the time zone is not in the file: times are the wearer's")
        return Log(
            name,
            packets,
            tuple(notes),
            self.lost,
            0.0,
            zone or 0,
            device="ActiGraph",
            serial=serial,
        )

    def pieces(self) -> Iterator[bytes]:
        """The samples' bytes; what a damaged archive still gives.

        A failure ends the pieces, and the one that was on its way is lost.
        """
        passed = 0
        try:
            for piece in self._pieces(self._data):
                passed += len(piece)
                yield piece
        except _DAMAGED as error:
            self.refuse(f"the archive breaks off: {error}", passed)
            self.lost.append(f"{self._data} breaks off after {passed} bytes: {error}")

    def refuse(self, what: str, at: int) -> None:
        """Raise UnreadableInput where a damaged file is not wanted."""
        if self.strict:
            raise UnreadableInput(what, where=f"{self.path}, byte {at} of {self._data}")

    def _pieces(self, name: str) -> Iterator[bytes]:
        """A member, unpacked while it is read. Raises what `_DAMAGED` holds, and where it breaks
        off only after all that comes before."""
        if self._whole:
            with zipfile.ZipFile(self.path) as archive, archive.open(name) as stream:
                yield from iter(lambda: stream.read(_PIECE), b"")
            return
        found = _by_headers(self.path)[name]
        with self.path.open("rb") as raw:
            raw.seek(found.at)
            yield from (_inflate if found.deflated else _stored)(raw, found)

    def _demand_likely(self) -> None:
        with zipfile.ZipFile(self.path) as archive:
            member = archive.getinfo(self._data)
        if member.file_size > max(_LARGE, _RATIO * member.compress_size):
            size, packed = member.file_size, member.compress_size
            what = f"{self._data} claims {size} bytes in {packed}: no recording is so even"
            raise UnreadableInput(what, where=str(self.path))

    def _facts(self) -> tuple[float, float]:
        """Sample rate (Hz) and counts a g."""
        where = str(self.path)
        try:
            rate = float(self.info["Sample Rate"].replace(",", "."))
            scale = float(self.info.get("Acceleration Scale", "").replace(",", ".") or 341.0)
        except (KeyError, ValueError):
            what = "info.txt states no sample rate or scale"
            raise UnreadableInput(what, where=where) from None
        if not (0.0 < rate <= _MOST_RATE and 0.0 < scale < float("inf")):
            raise UnreadableInput(f"sample rate {rate:g} and scale {scale:g}", where=where)
        return rate, scale


def _sound(path: Path) -> bool:
    """Whether the archive has a directory of usual size that can be read."""
    try:
        if not small_directory(path):
            return False
        with zipfile.ZipFile(path):
            return True
    except _DAMAGED:
        return False


class _Member(NamedTuple):
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


def _inflate(raw: BinaryIO, found: _Member) -> Iterator[bytes]:
    unpacker, crc = zlib.decompressobj(-15), 0
    while not unpacker.eof:
        packed = unpacker.unconsumed_tail or raw.read(_PACKED)
        if not packed:
            raise EOFError("the archive ends within it")
        piece = unpacker.decompress(packed, _PIECE)
        crc = zlib.crc32(piece, crc)
        yield piece
    after = (unpacker.unused_data + raw.read(8)).removeprefix(_DESCRIPTOR)
    stated = int.from_bytes(after[:4], "little") if len(after) >= 4 else crc
    if crc != (stated if found.crc is None else found.crc):
        raise zipfile.BadZipFile("its checksum differs")


def _stored(raw: BinaryIO, found: _Member) -> Iterator[bytes]:
    missing, crc = found.packed, 0
    while piece := raw.read(_PIECE if missing is None else min(missing, _PIECE)):
        missing = None if missing is None else missing - len(piece)
        crc = zlib.crc32(piece, crc)
        yield piece
    if missing:
        raise EOFError("the archive ends within it")
    if found.crc not in (None, crc):
        raise zipfile.BadZipFile("its checksum differs")
