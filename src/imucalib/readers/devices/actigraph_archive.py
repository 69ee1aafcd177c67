"""ActiGraph's archives: a zip of info.txt, text with a "name: value" a line, and of the samples.

What is damaged in one, and how it is told. Layout: ActiGraph's public GT3X file format.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucalib.errors import UnreadableInput

#: What a damaged archive raises, depending on where the damage is.
DAMAGED = (
    zipfile.BadZipFile, zlib.error, KeyError, EOFError, OSError, ValueError, NotImplementedError,
    RuntimeError, struct.error,
)  # fmt: skip
_MOST_RATE = 10_000.0  # Hz
_PIECE = 1 << 16  # bytes: what a checksum that fails at the end may cost
#: What no device writes: a longer info.txt, a large log that packs better than this.
_INFO_BYTES, _LARGE, _RATIO = 1 << 20, 16 << 20, 100


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


def members_of(path: Path, head: bytes) -> frozenset[str] | None:
    """Names of an archive's members: none where the head is no archive's, None where it is
    damaged."""
    if not head.startswith(b"PK\x03\x04"):
        return frozenset()
    try:
        with zipfile.ZipFile(path) as archive:
            return frozenset(archive.namelist())
    except DAMAGED:
        return None


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


def pieces_of(path: Path, loss: Loss) -> Iterator[bytes]:
    """log.bin piece by piece; what a damaged archive still gives.

    A failure ends the pieces, and the one that was on its way is lost.
    """
    passed = 0
    try:
        with zipfile.ZipFile(path) as archive, archive.open("log.bin") as log:
            while piece := log.read(_PIECE):
                passed += len(piece)
                yield piece
    except DAMAGED as error:
        loss.refuse(f"the archive breaks off: {error}", passed)
        loss.broken = f"log.bin breaks off after {passed} bytes: {error}"
