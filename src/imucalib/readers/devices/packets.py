"""Packets of samples under one time stamp each, as loggers write them: bytes, clock and channels.

The file is a stream, plain or gzipped. gzip ends with a checksum and the length of what it holds
(RFC 1952): a stream that is cut, be it between two sectors, or whose bytes changed is reported, and
gives what comes before. A stamp names one sample of its packet. Between the stamps of packets that
follow each other the samples are evenly spread, so a sensor that is faster or slower than it says
keeps the logger's time. A packet that does not follow the one before, whatever its number says,
begins a new part.
"""

from __future__ import annotations

import gzip
import re
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from io import BufferedReader
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.errors import UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.readers.fields.conversion import Conversion, UnitSource, find_conversion
from imucalib.readers.fields.timebase import find_gaps
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording

_GZIP, _GZIP_BITS = b"\x1f\x8b", 31
_FEED = 1 << 13  # bytes at a time: what comes before damage in them is lost with them
_SLACK = 2.0  # samples that a stamp may be off
_AROUND = 3.0  # s of packets on each side that decide a sample's time
_GAP = 1.75  # periods
_PACKET = np.dtype([("stamp", "i8"), ("at", "i8"), ("count", "i8"), ("rate", "f8"), ("warm", "f8")])
_SECOND = 1_000_000_000  # ns


@dataclass
class Stream:
    """Bytes of a file. lost : gets a sentence when they end too early"""

    source: gzip.GzipFile | BufferedReader
    where: str
    strict: bool
    lost: list[str]
    _ahead: bytes = b""
    _passed: int = 0

    def read(self, size: int) -> bytes:
        """The next `size` bytes; fewer at the end, or where the packing breaks off.

        Raises UnreadableInput there with `strict`.
        """
        held, parts = len(self._ahead), [self._ahead]
        try:
            while held < size and (piece := self.source.read1(_FEED)):
                parts.append(piece)
                held += len(piece)
                self._passed += len(piece)
        except (OSError, EOFError, zlib.error) as error:
            what = f"the file breaks off after {self._passed} bytes of its content: {error}"
            if self.strict:
                remedy = "copy the file from the device again"
                raise UnreadableInput(what, where=self.where, remedy=remedy) from None
            self.lost.append(what)
        whole = b"".join(parts)
        self._ahead = whole[size:]
        return whole[:size]


def head_unpacked(head: bytes, size: int) -> bytes:
    """The file's first bytes, at most `size` of them where they are packed; none if damaged."""
    if not head.startswith(_GZIP):
        return head
    try:
        return zlib.decompressobj(_GZIP_BITS).decompress(head, size)
    except zlib.error:
        return b""


@contextmanager
def open_packets(path: Path, *, strict: bool, lost: list[str]) -> Iterator[Stream]:
    """The file's bytes, unpacked where they are gzipped."""
    with path.open("rb") as raw:
        packed = raw.peek(2).startswith(_GZIP)
        yield Stream(gzip.GzipFile(fileobj=raw) if packed else raw, str(path), strict, lost)


def zone_of(text: str) -> int | None:
    """Seconds east of UTC of "GMT +01:00" or "-05:30:00"; None where none are stated."""
    found = re.search(r"([+-]?)(\d{1,2}):(\d\d)(?::(\d\d))?", text)
    if found is None:
        return None
    size = 3600 * int(found[2]) + 60 * int(found[3]) + int(found[4] or 0)
    return -size if found[1] == "-" else size


def unpack_twelve_bits(raw: bytes | NDArray[np.uint8]) -> NDArray[np.int16]:
    """(n,) numbers of twelve bits in two's complement, two in each three bytes."""
    codes = np.frombuffer(raw, np.uint8).reshape(-1, 3).astype(np.int16)
    first = codes[:, 0] << 4 | codes[:, 1] >> 4
    numbers = np.stack([first, (codes[:, 1] & 15) << 8 | codes[:, 2]], axis=1).reshape(-1)
    return np.where(numbers > 2047, numbers - 4096, numbers).astype(np.int16)


class Packets(NamedTuple):
    """p packets with n samples in all, in the file's order; made by `packets_of`."""

    heads: NDArray[np.void]
    acc: Array
    gyro: Array

    @property
    def first(self) -> NDArray[np.int64]:
        """(p,) the first sample of each packet."""
        return np.asarray(np.cumsum(self.heads["count"]) - self.heads["count"])

    def part(self, first: int, stop: int) -> Packets:
        """Packets `first` to `stop` with their samples."""
        a, b = (int(self.heads["count"][:k].sum()) for k in (first, stop))
        return Packets(self.heads[first:stop], self.acc[a:b], self.gyro[a:b])


def packets_of(
    acc: Array, gyro: Array | None = None, **heads: NDArray[np.generic] | float
) -> Packets:
    """Packets of samples.

    acc : (n, 3) g; gyro : (n, 3) deg/s, NaN where there is none
    heads : (p,) or one for all: stamp, ns since 1970 on the device's clock; at, the sample, from
    the packet's first (0), to which it belongs; count, samples; rate, Hz as stated; warm, °C (NaN)
    """
    found = np.zeros(np.size(heads["stamp"]), dtype=_PACKET)
    for name, values in {"warm": np.nan, **heads}.items():
        found[name] = values
    return Packets(found, acc, np.full(acc.shape, np.nan) if gyro is None else gyro)


@dataclass(frozen=True)
class Log:
    """A device's file, opened: packets piece by piece, and what its header says.

    device, serial : what the header names, or empty
    lost : filled while the packets are read, with a sentence for what was damaged
    drift : share by which the sensor's true rate may differ from what it states
    zone_s : of the device's clock, east of UTC
    cut : whether its stamps may be cut to whole seconds
    """

    format: str
    packets: Iterator[Packets]
    notes: tuple[str, ...]
    lost: list[str]
    drift: float
    zone_s: int = 0
    cut: bool = False
    device: str = ""
    serial: str = ""


def recordings(log: Log, path: Path, mapping: FieldMapping, samples: int) -> Iterator[Recording]:
    """The log's channels in SI, in blocks of about so many samples.

    Raises UnreadableInput when the log holds no packets.
    """
    digest = sha256_of(path)
    before: float | None = None
    units: dict[str, Conversion] = {}
    held: Recording | None = None
    rate = 0.0
    whole = _within_seconds(log.packets, log.drift) if log.cut else log.packets
    for packets, origin, t in _time_packets(whole, log.drift, samples):
        notes: tuple[str, ...] = ()
        if held is None:
            rate = float(packets.heads["rate"][0])
            units = _units(packets, rate, mapping, str(path))
            notes = (*log.notes, *(how.note for how in units.values() if how.note))
        else:
            yield held
        gaps = find_gaps(t, range(t.size), _GAP / rate, before)
        before = float(t[-1]) if t.size else before
        held = Recording(
            channels=_channels(packets, t, rate, units),
            path=str(path),
            format=log.format,
            sha256=digest,
            start_ns=origin - log.zone_s * 1_000_000_000,
            gaps=tuple(gaps),
            notes=notes,
            mapping={"acc_unit": units["acceleration"].source_unit},
            device=log.device,
            serial=log.serial,
        )
    if held is None:
        what = "; ".join(["no samples with times in it", *log.lost])
        raise UnreadableInput(what, where=str(path), remedy="copy the file from the device again")
    yield replace(held, notes=(*held.notes, *log.lost))


def _units(
    packets: Packets, rate: float, mapping: FieldMapping, where: str
) -> dict[str, Conversion]:
    each = (
        ("acceleration", "g", packets.acc),
        ("angular_rate", "deg/s", packets.gyro),
        ("temperature", "degC", packets.heads["warm"]),
    )
    return {
        q: find_conversion(q, mapping, UnitSource(unit, fixed=True), [x], rate=rate, where=where)
        for q, unit, x in each
    }


def _channels(
    packets: Packets, t: Array, rate: float, units: dict[str, Conversion]
) -> dict[str, Channel]:
    """Acceleration, and angular rate and temperature where there are any."""
    warm, count = packets.heads["warm"], packets.heads["count"]
    turned = np.isfinite(packets.gyro).all(axis=1)
    known = np.isfinite(warm) & (count > 0)
    found = {
        "acceleration": (t, packets.acc, rate),
        "angular_rate": (t[turned], packets.gyro[turned], rate),
        "temperature": (t[packets.first[known]], warm[known, None], rate / np.median(count)),
    }
    return {
        f"imu0/{quantity}": Channel(
            at,
            units[quantity].apply(raw),
            quantity=quantity,
            triad="imu0",
            rate=float(own),
            numbered=True,
            **units[quantity].units,
        )
        for quantity, (at, raw, own) in found.items()
        if at.size or quantity == "acceleration"
    }


def _time_packets(
    pieces: Iterator[Packets], drift: float, samples: int
) -> Iterator[tuple[Packets, int, Array]]:
    """Packets of about so many samples, the time of the log's first sample (ns), and that of every
    sample since it.

    Packets on both sides of a block take part in its times, so that blocks do not matter.
    """
    origin: int | None = None
    back, held = list[Packets](), list[Packets]()
    more = True
    while more:
        piece = next(pieces, None)
        more = piece is not None
        held += [piece] if piece is not None and piece.heads.size else []
        if not held or (more and sum(len(p.acc) for p in held) < samples):
            continue
        whole = Packets(*map(np.concatenate, zip(*back, *held, strict=True)))
        first, rate = sum(p.heads.size for p in back), float(whole.heads["rate"].max())
        around = 2 + int(_AROUND * rate / max(1.0, float(np.median(whole.heads["count"]))))
        ready = whole.heads.size - (around if more else 0)
        if ready <= first:
            continue
        base, ends = int(whole.heads["stamp"][0]), np.cumsum(whole.heads["count"])
        seconds, begins = _times(whole, base, drift), whole.first
        if origin is None:
            origin = base + round(float(seconds[begins[first]]) * 1e9 if seconds.size else 0.0)
        full = np.diff((ends[first:ready] - begins[first]) // samples)
        edges = [first, *(np.flatnonzero(full) + first + 1).tolist(), ready]
        for a, b in pairwise(edges):
            t = seconds[begins[a] : ends[b - 1]] + (base - origin) * 1e-9
            yield whole.part(a, b), origin, t
        back = [whole.part(max(0, ready - around), ready)]
        held = [whole.part(ready, whole.heads.size)]


def _within_seconds(pieces: Iterator[Packets], drift: float) -> Iterator[Packets]:
    """The same packets; stamps that are whole seconds where the samples between them are not are
    moved within these, so that each packet begins where the one before ends, at the rate that is
    stated as far as that goes."""
    ahead = np.nan  # ns, where the next packet begins
    for piece in pieces:
        stamps, index, period = _clock_of(piece)
        lasts = np.diff(index) * period[1:] % _SECOND  # beyond whole seconds
        exact = np.isnan(ahead) and bool(((lasts < 1.0) | (lasts > _SECOND - 1.0)).all())
        if exact or (stamps % _SECOND).any():
            ahead = np.nan
            yield piece
            continue
        apart = ~_follow(stamps, index, period, drift, float(_SECOND))
        edges = [0, *(np.flatnonzero(apart) + 1).tolist(), stamps.size]
        moved = stamps.astype(np.float64)
        for a, b in pairwise(edges):
            ran = (index[a:b] - index[a]) * period[a]
            begins = _cut(moved[a:b] - ran, ahead + piece.heads["at"][a] * period[a])
            moved[a:b] = begins + ran
            ahead = moved[b - 1] + (piece.heads["count"] - piece.heads["at"])[b - 1] * period[a]
        heads = piece.heads.copy()
        heads["stamp"] = np.rint(moved).astype(np.int64)
        yield piece._replace(heads=heads)


def _cut(least: Array, start: float) -> Array:
    """(k,) where a line lies above each of k stamps by less than the second that was cut off.

    least : (k,) ns, of the line were nothing cut off; start : where it comes from, NaN for nowhere
    """
    low, high = float(least.max()), float(least.min()) + _SECOND
    start = start if abs(start - least[0]) < 2 * _SECOND else 0.5 * (low + high)
    if low <= high:
        return np.full(least.size, np.clip(start, low, high))
    each = accumulate(least.tolist(), lambda at, b: min(max(at, b), b + _SECOND), initial=start)
    return np.array(list(each)[1:])


def _clock_of(packets: Packets) -> tuple[NDArray[np.int64], Array, Array]:
    """(p,) stamps (ns), samples to which they belong, sampling periods (ns)."""
    heads = packets.heads
    return heads["stamp"], (packets.first + heads["at"]).astype(np.float64), 1e9 / heads["rate"]


def _follow(
    stamps: NDArray[Any], index: Array, period: Array, drift: float, cut: float = 0.0
) -> Flags:
    """(p - 1,) whether each packet follows the one before; cut : what stamps may lack"""
    steps, took = np.diff(index), np.diff(stamps)
    expected = steps * period[1:]
    slack = drift * np.abs(expected) + _SLACK * period[1:] + cut
    return np.asarray(
        (np.abs(took - expected) <= slack) & (steps >= 0) & (period[1:] == period[:-1])
    )


def _times(packets: Packets, base: int, drift: float) -> Array:
    """Seconds since `base` of every sample."""
    heads, first = packets.heads, packets.first
    _, index, _ = _clock_of(packets)
    stamp: Array = (heads["stamp"] - base) * 1e-9
    period: Array = 1.0 / heads["rate"]
    follows = _follow(stamp, index, period, drift)
    edges = np.concatenate([[0], np.flatnonzero(~follows) + 1, [index.size]])
    out = np.empty(packets.acc.shape[0])
    for a, b in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        rows = np.arange(first[a], first[b - 1] + heads["count"][b - 1])
        out[rows] = _spread_samples(rows, index[a:b], stamp[a:b], float(period[a]))
    return out


def _spread_samples(rows: NDArray[np.int64], index: Array, stamp: Array, period: float) -> Array:
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
