"""Axivity AX3 and AX6: .cwa files, plain or gzipped, and CSV exports of OmGui.

A header of 1024 bytes ("MD"), then sectors of 512 bytes ("AX"), each with its own time stamp and a
checksum: its 16-bit words add up to zero. Layout: Open Movement, Docs/ax3/cwa.h and
ax3-technical.md. Sectors are known by their mark and checksum and ordered by the file, never by
their counter, which restarts.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UnreadableInput
from imucalib.readers.devices.catalogue import Device
from imucalib.readers.devices.packets import (
    Log,
    Packets,
    Stream,
    head_unpacked,
    open_packets,
    packets_of,
    recordings,
)
from imucalib.readers.fields.joining import Joined
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Recording

_HEAD, _SECTOR, _SAMPLES = 1024, 512, 120
_MARK, _START = b"AX\xfc\x01", b"MD\xfc\x03"
#: Marks without a sector, and bytes without one, after which a file is no recording.
_MOST_BAD, _MOST_WASTE = 100_000, 64 << 20
_DRIFT = 0.15  # the accelerometer's own oscillator sets the pace
_COMMON = 10  # the code of 100 Hz
_PIECE, _CODES = 1 << 20, 4096  # bytes, and candidates that are judged, at a time
_TYPE = np.dtype(
    [
        ("mark", "S4"),
        ("fraction", "<u2"),
        ("session", "<u4"),
        ("number", "<u4"),
        ("stamp", "<u4"),
        ("scales", "<u2"),
        ("warm", "<u2"),
        ("events", "u1"),
        ("battery", "u1"),
        ("rate", "u1"),
        ("axes", "u1"),
        ("at", "<i2"),
        ("count", "<u2"),
        ("data", "u1", 480),
        ("checksum", "<u2"),
    ]
)
Bytes = NDArray[np.uint8]
DEVICE = Device(
    "axivity",
    FieldMapping(time="1", acc=("2", "3", "4"), acc_unit="g"),
    source="wadpac/GGIR, inst/testfiles/ax3_testfile.csv",
)


class CwaReader(Joined):
    """The reader of Axivity's own files."""

    name = "cwa"
    suffixes = (".cwa", ".cwa.gz")
    fixed = True

    def recognises(self, path: Path, head: bytes) -> bool:
        """The header's mark, or the first sector's where the header is damaged."""
        head = head_unpacked(head, 2 * _HEAD)
        return head.startswith(_START) or head[_HEAD : _HEAD + 4] == _MARK

    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """Read in blocks of whole sectors; damage costs its sector."""
        lost: list[str] = []
        with open_packets(path, strict=strict, lost=lost) as stream:
            head = stream.read(_HEAD)
            packets = map(_packets, _sectors(stream, str(path), lost=lost, strict=strict))
            kind, number = _device(head)
            clock = "times are the device's own, without a zone: taken as UTC"
            notes = (*([f"Axivity {kind} {number}"] if number else []), clock)
            log = Log(
                self.name, packets, notes, lost, _DRIFT, device=f"Axivity {kind}", serial=number
            )
            yield from recordings(log, path, mapping, block_samples)


READER = CwaReader()


def _device(head: bytes) -> tuple[str, str]:
    """Kind and number of the device, the number empty where the header is damaged."""
    kind = "AX6" if head[4:5] == b"\x64" else "AX3"
    number = int.from_bytes(head[5:7], "little")
    upper = int.from_bytes(head[11:13], "little")
    number += 0 if upper == 0xFFFF else upper << 16
    return kind, str(number) if head.startswith(_START) else ""


def _sectors(stream: Stream, where: str, *, lost: list[str], strict: bool) -> Iterator[Bytes]:
    """Sound sectors (n, 512), from pieces of the file."""
    rest, passed, waste, bad, good = b"", _HEAD, 0, 0, 0
    while True:
        piece = stream.read(_PIECE)
        data = rest + piece
        keep = len(data) - (_SECTOR - 1 if piece else 0)  # a sector that begins later may go on
        found, tried = _sound(data, keep)
        end = max(int(found[-1]) + _SECTOR if found.size else 0, keep, 0)
        end = min(end, len(data))
        wasted = end - found.size * _SECTOR
        if strict and wasted:
            raise UnreadableInput(
                "bytes of no whole sector",
                where=f"{where}, byte {passed} and later",
                remedy="copy the file from the device again, or read what is left without --strict",
            )
        waste, bad, good = waste + wasted, bad + tried - found.size, good + found.size
        if bad > _MOST_BAD or waste > max(_MOST_WASTE, 8 * good * _SECTOR):
            raise UnreadableInput("this holds hardly any sound sectors", where=where)
        if found.size:
            codes = np.frombuffer(data, np.uint8)
            yield np.lib.stride_tricks.sliding_window_view(codes, _SECTOR)[found]
        rest, passed = data[end:], passed + end
        if not piece:
            break
    if waste:
        lost.append(f"{waste} bytes that belong to no sound sector were left out")


def _sound(data: bytes, keep: int) -> tuple[NDArray[np.intp], int]:
    """Where sound sectors begin, below `keep`, none in another; and how many marks were tried."""
    last = min(keep, len(data) - _SECTOR + 1)
    at = np.array([m.start() for m in re.finditer(re.escape(_MARK), data[: last + 3])], np.intp)
    at = at[at < last]
    if not at.size:
        return at, 0
    windows = np.lib.stride_tricks.sliding_window_view(np.frombuffer(data, np.uint8), _SECTOR)
    sound = np.concatenate(
        [_adds_up(windows[at[k : k + _CODES]]) for k in range(0, at.size, _CODES)]
    )
    found = at[sound]
    while found.size and (overlap := np.diff(found) < _SECTOR).any():
        found = np.delete(found, int(np.argmax(overlap)) + 1)
    return found, at.size


def _adds_up(sectors: Bytes) -> NDArray[np.bool_]:
    """Checksum right, and no more samples than there is room for."""
    fields = np.ascontiguousarray(sectors).view(_TYPE)[:, 0]
    total = np.ascontiguousarray(sectors).view("<u2").sum(axis=1, dtype=np.uint32) & 0xFFFF
    axes, packed = fields["axes"] >> 4, (fields["axes"] & 15) == 0
    wide = np.where(packed, 4, 2 * axes)
    known = packed & (axes == 3) | ((fields["axes"] & 15) == 2) & np.isin(axes, (3, 6, 9))
    sound: NDArray[np.bool_] = (
        (total == 0) & known & (fields["count"].astype(np.int64) * wide <= 480)
    )
    return sound


def _packets(sectors: Bytes) -> Packets:
    """The samples of sound sectors; those without a date or samples are left out."""
    fields = np.ascontiguousarray(sectors).view(_TYPE)[:, 0]
    stamp, dated = _stamps(fields["stamp"])
    fields, stamp = fields[dated & (fields["count"] > 0)], stamp[dated & (fields["count"] > 0)]
    rate = _rates(fields, stamp)
    fraction = np.where(fields["fraction"] & 0x8000, (fields["fraction"] & 0x7FFF) / 32768.0, 0.0)
    count = fields["count"].astype(np.int64)
    warm = fields["warm"] & 1023
    return packets_of(
        *_values(fields, count),
        stamp=stamp * 1_000_000_000 + np.rint(fraction * 1e9).astype(np.int64),
        # The device moves the index to the whole second: the fraction's samples belong to it again.
        at=fields["at"].astype(np.int64) + np.floor(fraction * rate).astype(np.int64),
        count=count,
        rate=rate,
        warm=np.where(warm, warm * (75.0 / 256.0) - 50.0, np.nan),
    )


def _rates(fields: NDArray[np.void], stamp: NDArray[np.int64]) -> Array:
    """Hz of each sector, by its code; where that is 0, which is none, by what the others have, or
    else by the stamps, of the rates that the device has."""
    code = (fields["rate"] & 15).astype(np.int64)
    unknown = code == 0
    if unknown.any():
        first = np.cumsum(fields["count"].astype(np.int64)) - fields["count"]
        took, passed = np.diff(stamp), np.diff(first + fields["at"])
        pace = passed[took > 0] / took[took > 0]
        known = code[~unknown]
        if pace.size and (typical := float(np.median(pace))) > 0.0:
            nearest = 15 - round(float(np.log2(3200.0 / typical)))
        else:
            nearest = int(np.median(known)) if known.size else _COMMON
        code[unknown] = min(max(nearest, 1), 15)
    return np.asarray(3200.0 / (1 << (15 - code)), dtype=np.float64)


def _stamps(packed: NDArray[np.uint32]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Seconds since 1970 of packed dates (year, month, day, hour, minute, second), and validity."""
    bits = packed.astype(np.int64)
    year, month, day = 2000 + (bits >> 26), bits >> 22 & 15, bits >> 17 & 31
    hour, minute, second = bits >> 12 & 31, bits >> 6 & 63, bits & 63
    good = (month >= 1) & (month <= 12) & (day >= 1) & (hour < 24) & (minute < 60) & (second < 60)
    months = ((year - 1970) * 12 + np.where(good, month, 1) - 1).astype("M8[M]")
    days = months.astype("M8[D]") + (np.where(good, day, 1) - 1).astype("m8[D]")
    good &= days.astype("M8[M]") == months
    return days.astype(np.int64) * 86_400 + hour * 3600 + minute * 60 + second, good


def _values(fields: NDArray[np.void], count: NDArray[np.int64]) -> tuple[Array, Array]:
    """Acceleration (g) and angular rate (deg/s) of all samples, sector after sector."""
    first, n = np.cumsum(count) - count, int(count.sum())
    acc, gyro = np.empty((n, 3)), np.full((n, 3), np.nan)
    for axes in np.unique(fields["axes"]).tolist():
        some = fields["axes"] == axes
        filled = np.arange(_SAMPLES) < count[some, None]  # places of each sector
        rows = (first[some, None] + np.arange(_SAMPLES))[filled]
        data = np.ascontiguousarray(fields["data"][some])
        if axes & 15 == 0:
            acc[rows] = _unpack(data.view("<u4"))[filled] / 256.0
            continue
        wide = axes >> 4
        places = 480 // (2 * wide)
        words = data[:, : places * 2 * wide].view("<i2").reshape(-1, places, wide)
        samples = words[:, :_SAMPLES][filled[:, :places]]
        scales = np.repeat(fields["scales"][some].astype(np.int64), count[some])[:, None]
        acc[rows] = samples[:, (0 if wide == 3 else 3) :][:, :3] * 2.0 ** -(8 + (scales >> 13))
        if wide > 3:
            gyro[rows] = samples[:, :3] * (8000.0 / 2.0 ** (scales >> 10 & 7) / 32768.0)
    return acc, gyro


def _unpack(words: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Three numbers of ten bits and a common exponent of two, (..., 3)."""
    axes = np.stack([words >> shift & 1023 for shift in (0, 10, 20)], axis=-1).astype(np.int64)
    signed = np.where(axes > 511, axes - 1024, axes)
    return np.asarray(signed << (words >> 30).astype(np.int64)[..., None])
