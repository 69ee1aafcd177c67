"""Axivity .wav: a .cwa as omconvert resamples it, 16-bit samples behind headers with its facts.

RIFF chunks; LIST/INFO holds texts of "name: value" lines, ICMT the channels and their scales (a
full-scale sample, g), ICRD the time of the first sample. The auxiliary channel says what is
available, and has a temperature now and then. Layout: Open Movement, Docs/ax3/omconvert.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.packets import Log, Packets, recordings
from imucalib.readers.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_FULL, _SCALE = 32768.0, "8"  # of a sample; g, where a channel's is not stated
_MOST_HEADER = 1 << 20
_PER_PACKET = 120
_MISSING, _KIND, _TEMPERATURE = 0x8000, 0x3C00, 0x0C00  # of the auxiliary channel


@dataclass(frozen=True)
class _Head:
    """rate : Hz; channels : names in order; scales : (k,) of a full-scale sample; start : ns since
    1970 on the device's clock; at, size : of the samples, bytes; device : its number, or empty"""

    rate: float
    channels: tuple[str, ...]
    scales: Array
    start: int
    at: int
    size: int
    device: str

    def triad(self, words: str) -> list[int]:
        """Columns of the channels "Accel-X" to "-Z", or none."""
        names = [f"{words}-{a}" for a in "XYZ"]
        found = [self.channels.index(n) for n in names if n in self.channels]
        return found if len(found) == 3 else []


class WavReader(Joined):
    """The reader of Axivity's .wav files."""

    name = "wav"
    suffixes = (".wav",)
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """A RIFF file of waves whose comment names accelerations."""
        return head[:4] == b"RIFF" and head[8:12] == b"WAVE" and b"Accel-X" in head

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks; a file that breaks off gives what comes before."""
        lost: list[str] = []
        with path.open("rb") as stream:
            head = _head(stream, str(path))
            pieces = _packets(stream, head, max(1, block_samples // _PER_PACKET), lost)
            notes = (
                f"Axivity {head.device or 'of unknown number'}, resampled to {head.rate:g} Hz",
                "times are the device's own, without a zone: taken as UTC",
            )
            whole = path.stat().st_size - head.at
            if strict and whole < head.size:
                what = f"the header states {head.size} bytes of samples, {whole} were found"
                raise UnreadableInput(what, where=str(path), remedy="read it without --strict")
            yield from recordings(Log(self.name, pieces, notes, lost, 0.0), path, mapping)


READER = WavReader()


def _head(stream: BinaryIO, where: str) -> _Head:
    raw = stream.read(_MOST_HEADER)
    at, found, texts = 12, dict[bytes, bytes](), dict[bytes, str]()
    while at + 8 <= len(raw):
        kind, size = struct.unpack_from("<4sI", raw, at)
        if kind == b"data":
            break
        found[kind] = body = raw[at + 8 : at + 8 + size]
        if kind == b"LIST" and body[:4] == b"INFO":
            texts.update(_texts(body))
        at += 8 + size + size % 2
    else:
        raise UnreadableInput("no samples behind its headers", where=where)
    facts = dict(
        (name.strip(), value.strip())
        for text in texts.values()
        for name, mark, value in (line.partition(":") for line in text.splitlines())
        if mark
    )
    try:
        form, count, rate = struct.unpack_from("<HHI", found[b"fmt "])
        bits = struct.unpack_from("<H", found[b"fmt "], 14)[0]
        channels = tuple(facts.get(f"Channel-{k + 1}", "") for k in range(count))
        scales = np.array([float(facts.get(f"Scale-{k + 1}", _SCALE)) for k in range(count)])
    except (KeyError, ValueError, struct.error) as error:
        raise UnreadableInput(f"its headers are damaged: {error!r}", where=where) from None
    if not (form in (1, 0xFFFE) and bits == 16 and rate > 0 and (scales > 0.0).all()):
        what = f"format {form} of {bits} bits at {rate} Hz: no wave file of an accelerometer"
        raise UnreadableInput(what, where=where)
    start = _date(texts.get(b"ICRD", "")) or _date(facts.get("Time", ""))
    if start is None:
        raise UnreadableInput("its headers state no time of the first sample", where=where)
    head = _Head(
        rate=float(rate),
        channels=channels,
        scales=scales,
        start=start,
        at=at + 8,
        size=size,
        device=facts.get("Id", ""),
    )
    if not head.triad("Accel"):
        raise UnreadableInput(f"no three accelerations among {', '.join(channels)}", where=where)
    return head


def _texts(body: bytes) -> Iterator[tuple[bytes, str]]:
    at = 4
    while at + 8 <= len(body):
        kind, size = struct.unpack_from("<4sI", body, at)
        yield kind, body[at + 8 : at + 8 + size].rstrip(b"\0 \r\n").decode("latin-1")
        at += 8 + size + size % 2


def _date(text: str) -> int | None:
    """ns since 1970 of "2014-08-01 10:00:00.000"."""
    found = re.match(r"(\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?", text.strip())
    try:
        whole = datetime.fromisoformat(f"{found[1]}T{found[2]}") if found else None
    except ValueError:
        whole = None
    if found is None or whole is None:
        return None
    seconds = int(whole.replace(tzinfo=UTC).timestamp())
    return seconds * 1_000_000_000 + int((found[3] or "0").ljust(9, "0"))


def _packets(stream: BinaryIO, head: _Head, packets: int, lost: list[str]) -> Iterator[Packets]:
    """Packets of 120 samples; where the data were not available, the next begins late."""
    stream.seek(head.at)
    wide, passed = 2 * len(head.channels), 0
    # A recorder that was cut off leaves no size, or the largest.
    stated = head.size // wide if 0 < head.size < 0xFFFF_FF00 else None
    while stated is None or passed < stated:
        most = (
            packets * _PER_PACKET if stated is None else min(packets * _PER_PACKET, stated - passed)
        )
        raw = stream.read(most * wide)
        rows = np.frombuffer(raw[: len(raw) // wide * wide], "<i2").reshape(-1, len(head.channels))
        if not rows.size:
            break
        yield from _of_rows(rows, passed, head)
        passed += len(rows)
    if stated is not None and passed < stated:
        lost.append(f"the header states {stated} samples, {passed} were found")


def _of_rows(rows: NDArray[np.int16], passed: int, head: _Head) -> Iterator[Packets]:
    aux = np.zeros(len(rows), np.uint16)
    if "Aux" in head.channels:
        aux = rows[:, head.channels.index("Aux")].astype(np.uint16)
    there = (aux & _MISSING) == 0
    if not there.any():
        return
    row = np.flatnonzero(there)
    first = np.flatnonzero((np.diff(row, prepend=-2) > 1) | (row % _PER_PACKET == 0))
    count = np.diff(first, append=row.size)
    warm = np.full(first.size, np.nan)
    hot = np.flatnonzero((aux[row] & _KIND) == _TEMPERATURE)
    at = np.searchsorted(first, hot, side="right") - 1
    warm[at] = (aux[row[hot]] & 1023) * (75.0 / 256.0) - 50.0
    stamp = head.start + np.rint((passed + row[first]) / head.rate * 1e9).astype(np.int64)
    turned = head.triad("Gyro")
    acc = rows[row][:, head.triad("Accel")] / _FULL * head.scales[head.triad("Accel")]
    gyro = np.full(acc.shape, np.nan)
    if turned:
        gyro = rows[row][:, turned] / _FULL * head.scales[turned]
    yield Packets(
        stamp=stamp,
        at=np.zeros_like(count),
        count=count,
        rate=np.full(first.size, head.rate),
        warm=warm,
        acc=acc,
        gyro=gyro,
    )
