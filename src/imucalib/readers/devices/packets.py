"""Packets of samples under one time stamp each, as loggers write them: bytes, clock and channels.

The file is a stream, plain or gzipped. gzip ends with a checksum and the length of what it holds
(RFC 1952): a stream that is cut, be it between two sectors, or whose bytes changed is told, and
gives what comes before. A stamp names one sample of its packet. Between the stamps of packets that
follow each other the samples are evenly spread, so a sensor that is faster or slower than it says
keeps the logger's time. A packet that does not follow the one before, whatever its number says,
begins a new part.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.conversion import (
    Conversion,
    Source,
    acceleration,
    angular_rate,
    readings_at_rest,
    temperature,
)
from imucalib.readers.source import sha256_of
from imucalib.readers.timebase import find_gaps
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording

_GZIP, _GZIP_BITS = b"\x1f\x8b", 31
_FEED = 1 << 10  # packed bytes at a time: what stands before damage in them is lost with them
_PLAIN = 1 << 16


@dataclass
class Stream:
    """Bytes of a file. lost : gets a sentence when they end too early"""

    pieces: Iterator[bytes]
    where: str
    strict: bool
    lost: list[str]
    ahead: bytes = b""
    passed: int = 0

    def read(self, size: int) -> bytes:
        """The next `size` bytes; fewer at the end, or where the packing breaks off.

        Raises UnreadableInput there with `strict`.
        """
        held, parts = len(self.ahead), [self.ahead]
        while held < size and (piece := self._next()) is not None:
            parts.append(piece)
            held += len(piece)
        whole = b"".join(parts)
        self.ahead = whole[size:]
        return whole[:size]

    def _next(self) -> bytes | None:
        try:
            piece = next(self.pieces, None)
        except (OSError, EOFError, zlib.error) as error:
            what = f"the file breaks off after {self.passed} bytes of its content: {error}"
            if self.strict:
                raise UnreadableInput(
                    what, where=self.where, remedy="copy the file from the device again"
                ) from None
            self.lost.append(what)
            return None
        self.passed += len(piece or b"")
        return piece


def head_unpacked(head: bytes, size: int) -> bytes:
    """The file's first bytes, at most `size` of them where they are packed; none if damaged."""
    if not head.startswith(_GZIP):
        return head
    try:
        return zlib.decompressobj(_GZIP_BITS).decompress(head, size)
    except zlib.error:
        return b""


@contextmanager
def opened(path: Path, *, strict: bool, lost: list[str]) -> Iterator[Stream]:
    """The file's bytes, unpacked where they are gzipped."""
    with path.open("rb") as raw:
        packed = raw.read(2) == _GZIP
        raw.seek(0)
        pieces = _unpacked(raw) if packed else iter(lambda: raw.read(_PLAIN), b"")
        yield Stream(pieces, str(path), strict, lost)


def _unpacked(raw: BinaryIO) -> Iterator[bytes]:
    """The content of gzip streams that follow each other; raises EOFError for one without end."""
    unpacker = zlib.decompressobj(_GZIP_BITS)
    while piece := raw.read(_FEED):
        while piece:
            if unpacker.eof:
                unpacker = zlib.decompressobj(_GZIP_BITS)
            yield unpacker.decompress(piece)
            # Zeros behind the end fill a block of a tape or a disk.
            piece = unpacker.unused_data.lstrip(b"\0") if unpacker.eof else b""
    if not unpacker.eof:
        raise EOFError("gzip's end mark is missing")


_SLACK = 2.0  # samples that a stamp may be off
_NEAR = 3.0  # s of packets on each side that decide a sample's time
_GAP = 1.75  # periods


@dataclass(frozen=True)
class Packets:
    """p packets with n samples in all, in the file's order.

    stamp : (p,) ns since 1970 on the device's clock; at : (p,) the sample, from the packet's first,
    to which it belongs; count : (p,) samples; rate : (p,) Hz as stated; warm : (p,) °C, or NaN
    acc : (n, 3) g; gyro : (n, 3) deg/s, NaN where there is none
    """

    stamp: NDArray[np.int64]
    at: NDArray[np.int64]
    count: NDArray[np.int64]
    rate: Array
    warm: Array
    acc: Array
    gyro: Array

    def part(self, first: int, stop: int) -> Packets:
        """Packets `first` to `stop` with their samples."""
        edges = np.concatenate([[0], np.cumsum(self.count)])
        rows = slice(int(edges[first]), int(edges[stop]))
        return Packets(
            **{
                f.name: getattr(self, f.name)[
                    rows if f.name in ("acc", "gyro") else slice(first, stop)
                ]
                for f in fields(self)
            }
        )


@dataclass(frozen=True)
class Log:
    """A device's file, opened: packets piece by piece, and what its header says.

    lost : filled while the packets are read, with a sentence for what was damaged
    drift : share by which the sensor's true rate may differ from what it states
    zone_s : of the device's clock, east of UTC
    """

    format: str
    packets: Iterator[Packets]
    notes: tuple[str, ...]
    lost: list[str]
    drift: float
    zone_s: int = 0


def recordings(log: Log, path: Path, mapping: FieldMapping) -> Iterator[Recording]:
    """The log's channels in SI, a block for each piece of packets.

    Raises UnreadableInput when the log holds no packets.
    """
    digest = sha256_of(path)
    before: float | None = None
    units: _Units | None = None
    held: Recording | None = None
    origin = 0
    for packets, stamps, t in _timed(log.packets, log.drift):
        if units is None:
            origin = int(stamps[0])
            rate = float(packets.rate[0])
            units = _units(packets, rate, mapping, str(path))
        if held is not None:
            yield held
        gaps = find_gaps(t, range(t.size), _GAP / units.rate, before)
        before = float(t[-1]) if t.size else before
        held = Recording(
            channels=_channels(packets, t, units),
            path=str(path),
            format=log.format,
            sha256=digest,
            start_ns=origin - log.zone_s * 1_000_000_000,
            gaps=tuple(gaps),
            notes=() if held is not None else (*log.notes, *units.notes),
            mapping={"acc_unit": units.acc.source_unit},
        )
    if held is None:
        remedy = "copy the file from the device again"
        raise UnreadableInput("no samples with times in it", where=str(path), remedy=remedy)
    yield replace(held, notes=(*held.notes, *log.lost))


@dataclass(frozen=True)
class _Units:
    rate: float
    acc: Conversion
    gyro: Conversion
    warm: Conversion
    notes: tuple[str, ...]


def _units(packets: Packets, rate: float, mapping: FieldMapping, where: str) -> _Units:
    rest = readings_at_rest([packets.acc], max(3, round(rate)))
    acc = acceleration(mapping, Source("g", fixed=True), rest, where)
    gyro = angular_rate(mapping, "deg/s", where)
    warm = temperature(mapping, "degC", packets.warm, where)
    return _Units(rate, acc, gyro, warm, tuple(c.note for c in (acc, gyro, warm) if c.note))


def _channels(packets: Packets, t: Array, units: _Units) -> dict[str, Channel]:
    def channel(quantity: str, at: Array, raw: Array, how: Conversion, rate: float) -> Channel:
        return Channel(at, how.apply(raw), how.unit, quantity, "imu0", rate)

    found = {"imu0/acceleration": channel("acceleration", t, packets.acc, units.acc, units.rate)}
    turned = np.isfinite(packets.gyro).all(axis=1)
    if turned.any():
        gyro = channel("angular_rate", t[turned], packets.gyro[turned], units.gyro, units.rate)
        found["imu0/angular_rate"] = gyro
    known = np.isfinite(packets.warm) & (packets.count > 0)
    if known.any():
        at = t[(np.cumsum(packets.count) - packets.count)[known]]
        rate = units.rate / float(np.median(packets.count))
        warm = channel("temperature", at, packets.warm[known, None], units.warm, rate)
        found["imu0/temperature"] = warm
    return found


def _joined(parts: list[Packets]) -> Packets:
    return Packets(
        **{f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Packets)}
    )


def _timed(
    pieces: Iterator[Packets], drift: float
) -> Iterator[tuple[Packets, NDArray[np.int64], Array]]:
    """Packets, the stamps from the log's first on, and the time of every sample since that first.

    Packets on both sides of a piece take part in its times, so that pieces do not matter.
    """
    origin: NDArray[np.int64] | None = None
    back, held = list[Packets](), list[Packets]()
    while True:
        piece = next(pieces, None)
        held += [piece] if piece is not None and piece.count.size else []
        if not held:
            if piece is None:
                return
            continue
        whole = _joined([*back, *held])
        first, near = (
            sum(p.count.size for p in back),
            2 + int(_NEAR * whole.rate.max() / max(1.0, float(np.median(whole.count)))),
        )
        ready = whole.count.size - (0 if piece is None else near)
        if ready > first:
            seconds = _times(whole, int(whole.stamp[0]), drift)
            edges = np.concatenate([[0], np.cumsum(whole.count)])
            start = seconds[edges[first]] if edges[first] < seconds.size else 0.0
            base = int(whole.stamp[0])
            if origin is None:
                origin = np.array([base + round(start * 1e9)], dtype=np.int64)
            t = seconds[edges[first] : edges[ready]] + (base - int(origin[0])) * 1e-9
            yield whole.part(first, ready), origin, t
            back = [whole.part(max(0, ready - near), ready)]
            held = [whole.part(ready, whole.count.size)]
        if piece is None:
            return


def _times(packets: Packets, base: int, drift: float) -> Array:
    """Seconds since `base` of every sample."""
    first = np.cumsum(packets.count) - packets.count
    index: Array = (first + packets.at).astype(np.float64)
    stamp = np.asarray((packets.stamp - base) * 1e-9, dtype=np.float64)
    period: Array = 1.0 / packets.rate
    steps: Array = np.diff(index)
    took: Array = np.diff(stamp)
    expected: Array = steps * period[1:]
    slack: Array = drift * np.abs(expected) + _SLACK * period[1:]
    follows = (np.abs(took - expected) <= slack) & (steps >= 0) & (period[1:] == period[:-1])
    edges = np.concatenate([[0], np.flatnonzero(~follows) + 1, [index.size]])
    out = np.empty(int(packets.count.sum()))
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        rows = np.arange(first[a], first[b - 1] + packets.count[b - 1])
        out[rows] = _spread(rows, index[a:b], stamp[a:b], float(period[a]))
    return out


def _spread(rows: NDArray[np.int64], index: Array, stamp: Array, period: float) -> Array:
    """Times of the samples `rows` on the line through (index, stamp), its ends drawn on."""
    new = np.concatenate([[True], (np.diff(index) > 0) & (np.diff(stamp) > 0)])
    index, stamp = index[new], stamp[new]
    if index.size == 1:
        return np.asarray(stamp[0] + (rows - index[0]) * period)
    t = np.interp(rows, index, stamp)
    low, high = rows < index[0], rows > index[-1]
    slope = np.diff(stamp) / np.diff(index)
    t[low] = stamp[0] + (rows[low] - index[0]) * slope[0]
    t[high] = stamp[-1] + (rows[high] - index[-1]) * slope[-1]
    return np.asarray(t)
