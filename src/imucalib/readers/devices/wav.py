"""Axivity .wav: a .cwa as omconvert resamples it, 16-bit samples after headers with its facts.

RIFF chunks; LIST/INFO holds texts of "name: value" lines, ICMT the channels and their scales (a
full-scale sample, g), ICRD the time of the first sample. The auxiliary channel says what is
available, and has a temperature now and then. Layout: Open Movement, Docs/ax3/omconvert.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.packets import Log, Packets, packets_of, recordings
from imucalib.readers.fields.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_FULL, _SCALE = 32768.0, 8.0  # of a sample; g, where a channel's is not stated
_MOST_HEADER = 1 << 20
_PER_PACKET = 120
_ROWS = 500 * _PER_PACKET  # that are read at a time
_MISSING, _KIND, _TEMPERATURE = 0x8000, 0x3C00, 0x0C00  # of the auxiliary channel


class _Head(NamedTuple):
    """rate : Hz; scales : (k,) of a full-scale sample; start : ns since 1970 on the device's clock;
    at, size : of the samples, bytes; aux : column of the auxiliary channel; acc, gyro : columns of
    these, or none"""

    rate: float
    scales: Array
    start: int
    at: int
    size: int
    aux: list[int]
    acc: list[int]
    gyro: list[int]


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
            facts, head = _head(stream.read(_MOST_HEADER), str(path))
            whole = path.stat().st_size - head.at
            if strict and whole < head.size:
                what = f"the header states {head.size} bytes of samples, {whole} were found"
                raise UnreadableInput(what, where=str(path), remedy="read it without --strict")
            serial = facts.get("Id", "")
            notes = (
                f"Axivity {serial or 'of unknown number'}, resampled to {head.rate:g} Hz",
                "times are the device's own, without a zone: taken as UTC",
            )
            packets = _packets(stream, head, lost)
            log = Log(self.name, packets, notes, lost, 0.0, device="Axivity", serial=serial)
            yield from recordings(log, path, mapping, block_samples)


READER = WavReader()


def _head(raw: bytes, where: str) -> tuple[dict[str, str], _Head]:
    """The facts of the texts before the samples, and where and how these are."""
    form, texts, data = b"", dict[bytes, str](), (0, 0)
    for kind, at, size in _chunks(raw, 12):
        data = (at, size)
        if kind == b"data":
            break
        if kind == b"fmt ":
            form = raw[at : at + size]
        if kind == b"LIST" and raw[at : at + 4] == b"INFO":
            for name, begin, length in _chunks(raw[: at + size], at + 4):
                text = raw[begin : begin + length].rstrip(b"\0 \r\n")
                texts[name] = text.decode("latin-1")
    else:
        raise UnreadableInput("no samples after its headers", where=where)
    lines = (line.partition(":") for text in texts.values() for line in text.splitlines())
    facts = {name.strip(): value.strip() for name, mark, value in lines if mark}
    try:
        code, count, rate = struct.unpack_from("<HHI", form)
        (bits,) = struct.unpack_from("<H", form, 14)
        scales = np.array([float(facts.get(f"Scale-{k + 1}", _SCALE)) for k in range(count)])
    except (ValueError, struct.error) as error:
        raise UnreadableInput(f"its headers are damaged: {error!r}", where=where) from None
    if not (code in (1, 0xFFFE) and bits == 16 and rate > 0 and (scales > 0.0).all()):
        what = f"format {code} of {bits} bits at {rate} Hz: no wave file of an accelerometer"
        raise UnreadableInput(what, where=where)
    start = _date(texts.get(b"ICRD", "")) or _date(facts.get("Time", ""))
    if start is None:
        raise UnreadableInput("its headers state no time of the first sample", where=where)
    channels = [facts.get(f"Channel-{k + 1}", "") for k in range(count)]
    columns = {word: _columns(channels, word) for word in ("Accel", "Gyro")}
    if not columns["Accel"]:
        raise UnreadableInput(f"no three accelerations among {', '.join(channels)}", where=where)
    head = _Head(
        rate=float(rate),
        scales=scales,
        start=start,
        at=data[0],
        size=data[1],
        aux=[k for k, name in enumerate(channels) if name == "Aux"][:1],
        acc=columns["Accel"],
        gyro=columns["Gyro"],
    )
    return facts, head


def _chunks(raw: bytes, at: int) -> Iterator[tuple[bytes, int, int]]:
    """Kind, first byte and size of RIFF chunks."""
    while at + 8 <= len(raw):
        kind, size = struct.unpack_from("<4sI", raw, at)
        yield kind, at + 8, size
        at += 8 + size + size % 2


def _columns(channels: list[str], word: str) -> list[int]:
    """Columns of the channels "Accel-X" to "-Z", or none."""
    names = [f"{word}-{axis}" for axis in "XYZ"]
    return [channels.index(name) for name in names] if set(names) <= set(channels) else []


def _date(text: str) -> int | None:
    """ns since 1970 of "2014-08-01 10:00:00.000"."""
    found = re.match(r"(\d{4}-\d\d-\d\d)[ T](\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?", text.strip())
    if found is None:
        return None
    try:
        seconds = int(np.datetime64(f"{found[1]}T{found[2]}", "s").astype(np.int64))
    except ValueError:
        return None
    return seconds * 1_000_000_000 + int((found[3] or "0").ljust(9, "0"))


def _packets(stream: BinaryIO, head: _Head, lost: list[str]) -> Iterator[Packets]:
    """Packets of 120 samples; where the data were not available, the next begins late."""
    stream.seek(head.at)
    wide, passed = 2 * head.scales.size, 0
    # A recorder that was cut off leaves no size, or the largest.
    stated = head.size // wide if 0 < head.size < 0xFFFF_FF00 else None
    while stated is None or passed < stated:
        raw = stream.read(wide * (_ROWS if stated is None else min(_ROWS, stated - passed)))
        rows = np.frombuffer(raw[: len(raw) // wide * wide], "<i2").reshape(-1, wide // 2)
        if not rows.size:
            break
        yield _of_rows(rows, passed, head)
        passed += len(rows)
    if stated is not None and passed < stated:
        lost.append(f"the header states {stated} samples, {passed} were found")


def _of_rows(rows: NDArray[np.int16], passed: int, head: _Head) -> Packets:
    aux = rows[:, head.aux[0]].astype(np.uint16) if head.aux else np.zeros(len(rows), np.uint16)
    row = np.flatnonzero((aux & _MISSING) == 0)
    first = np.flatnonzero((np.diff(row, prepend=-2) > 1) | (row % _PER_PACKET == 0))
    warm = np.full(first.size, np.nan)
    hot = np.flatnonzero((aux[row] & _KIND) == _TEMPERATURE)
    at = np.searchsorted(first, hot, side="right") - 1
    warm[at] = (aux[row[hot]] & 1023) * (75.0 / 256.0) - 50.0
    values = rows[row] / _FULL * head.scales
    return packets_of(
        values[:, head.acc],
        values[:, head.gyro] if head.gyro else None,
        stamp=head.start + np.rint((passed + row[first]) / head.rate * 1e9).astype(np.int64),
        count=np.diff(first, append=row.size),
        rate=head.rate,
        warm=warm,
    )
