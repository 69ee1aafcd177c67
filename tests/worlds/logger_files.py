"""Files as loggers write them, made number by number from their makers' public layouts.

All are synthetic: Axivity .cwa (Open Movement, Docs/ax3/cwa.h), GENEActiv .bin (instruction manual,
appendix on the binary file), ActiGraph .gt3x of the first firmwares (ActiGraph, "NHANES .gt3x File
Format"). Nothing here shares code with the readers.
"""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from functools import reduce
from operator import xor

import numpy as np
from numpy.typing import NDArray

Sample = Sequence[int]


def packed_date(when: datetime) -> int:
    """YYYYYYMM MMDDDDDh hhhhmmmm mmssssss."""
    date = (when.year - 2000) << 26 | when.month << 22 | when.day << 17
    return date | when.hour << 12 | when.minute << 6 | when.second


def ax_header(*, device: int = 4711, ax6: bool = False) -> bytes:
    """A file's first 1024 bytes."""
    head = bytearray(b"\xff" * 1024)
    head[:4] = b"MD\xfc\x03"
    head[4] = 0x64 if ax6 else 0x17
    head[5:7] = device.to_bytes(2, "little")
    return bytes(head)


def ax_sector(
    samples: Sequence[Sample], when: datetime, *, number: int = 0, at: int = 0, code: int = 0x4A,
    axes: int = 0x30, scales: int = 0, warm: int = 256, fraction: int = 0,
) -> bytes:  # fmt: skip
    """One sector; `axes` 0x30 packs, 0x32 and 0x62 write 16-bit words; `fraction` / 2^15 s."""
    if axes & 15:
        data = b"".join(struct.pack(f"<{len(s)}h", *s) for s in samples)
    else:
        data = b"".join(_ten_bits(s).to_bytes(4, "little") for s in samples)
    head = struct.pack(
        "<4sHIIIHHBBBBhH", b"AX\xfc\x01", (0x8000 | fraction) if fraction else 0, 1, number,
        packed_date(when), scales, warm, 0, 200, code, axes, at, len(samples),
    )  # fmt: skip
    body = (head + data).ljust(510, b"\0")
    total = sum(struct.unpack("<255H", body)) & 0xFFFF
    return body + struct.pack("<H", -total & 0xFFFF)


def _ten_bits(sample: Sample) -> int:
    """Three numbers with the smallest common exponent that holds them."""
    power = next(e for e in range(4) if all(-512 <= v >> e <= 511 for v in sample))
    word = power << 30
    for place, value in enumerate(sample):
        word |= (value >> power & 1023) << 10 * place
    return word


def ax_file(
    samples: Sequence[Sample], start: datetime, *, rate: float = 100.0, per_sector: int = 120,
    **sector: int,
) -> bytes:  # fmt: skip
    """A whole file: sectors whose stamps are the whole second and its sample."""
    out = [ax_header(ax6=sector.get("axes", 0) >> 4 == 6)]
    for number, first in enumerate(range(0, len(samples), per_sector)):
        seconds = first / rate
        whole = int(seconds) + (seconds > int(seconds))  # the next whole second
        at = round((whole - seconds) * rate)
        when = start + timedelta(seconds=whole)
        some = samples[first : first + per_sector]
        out.append(ax_sector(some, when, number=number, at=at, **sector))
    return b"".join(out)


GENE_HEADER = """Device Identity
Device Unique Serial Code:012345
Device Type:GENEActiv

Configuration Info
Measurement Frequency:{rate} Hz
Start Time:2020-05-21 16:16:38:500
Time Zone:GMT {zone}

Calibration Data
x gain:25522
x offset:272
y gain:25457
y offset:-1129
z gain:24829
z offset:101
Volts:42
Lux:886

Memory Status
Number of Pages:{pages}

"""


def gene_page(samples: Sequence[Sample], when: datetime, *, number: int, rate: float) -> bytes:
    """One page of 300 samples."""
    digits = "".join(
        f"{x & 0xFFF:03X}{y & 0xFFF:03X}{z & 0xFFF:03X}00{number & 1}" for x, y, z in samples
    )
    stamp = f"{when:%Y-%m-%d %H:%M:%S}:{when.microsecond // 1000:03d}"
    return (
        f"Recorded Data\nDevice Unique Serial Code:012345\nSequence Number:{number}\n"
        f"Page Time:{stamp}\nUnassigned:\nTemperature:{20 + number / 10:.1f}\n"
        f"Battery voltage:4.1\nDevice Status:Recording\nMeasurement Frequency:{rate}\n{digits}\n"
    ).encode()


def gene_file(
    samples: Sequence[Sample], start: datetime, *, rate: float = 50.0, zone: str = "+02:00"
) -> bytes:
    """A whole file."""
    pages = len(samples) // 300
    out = [GENE_HEADER.format(rate=rate, zone=zone, pages=pages).encode()]
    for k in range(pages):
        when = start + timedelta(seconds=k * 300 / rate)
        out.append(gene_page(samples[300 * k : 300 * k + 300], when, number=k, rate=rate))
    return b"".join(out)


def gt3x_record(kind: int, stamp: int, payload: bytes) -> bytes:
    """A record of log.bin."""
    body = struct.pack("<BBIH", 0x1E, kind, stamp, len(payload)) + payload
    return body + bytes([reduce(xor, body) ^ 0xFF])


def gt3x_second(samples: NDArray[np.int_], stamp: int, kind: int = 26) -> bytes:
    """A second's samples (n, 3); kind 0 has 12 bits a number, axes y x z."""
    payload = samples.astype("<i2").tobytes()
    if kind == 0:
        bits = "".join(f"{int(v) & 0xFFF:012b}" for v in samples[:, [1, 0, 2]].ravel())
        payload = int(bits, 2).to_bytes(len(bits) // 8, "big")
    return gt3x_record(kind, stamp, payload)


def old_gt3x(samples: Iterable[Sample], start: datetime, *, rate: int = 30) -> bytes:
    """An archive of the first firmwares: activity.bin, 12 bits a number, axes y x z."""
    digits = "".join(f"{v & 0xFFF:03x}" for x, y, z in samples for v in (y, x, z))
    ticks = int((start - datetime(1, 1, 1, tzinfo=UTC)).total_seconds()) * 10_000_000
    info = (
        "Serial Number: NEO1C16110020\r\nFirmware: 2.2.0\r\nBattery Voltage: 4.25\r\n"
        f"Sample Rate: {rate}\r\nStart Date: {ticks}\r\nStop Date: 0\r\nBoard Revision: 2\r\n"
    )
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("info.txt", info)
        file.writestr("activity.bin", bytes.fromhex(digits + "0" * (len(digits) % 2)))
        file.writestr("lux.bin", b"")
    return out.getvalue()


def wav_file(
    samples: Sequence[Sample], start: datetime, *, rate: int = 100, scale: int = 8,
    warm: int = 0, missing: Iterable[int] = (),
) -> bytes:  # fmt: skip
    """A wave file as omconvert writes it (Open Movement, Docs/ax3/omconvert); `scale` g is a full
    sample; warm : 10 bits in every tenth row; missing : rows that were not available."""
    lines = [f"Time: {start:%Y-%m-%d %H:%M:%S}.000"]
    for k, axis in enumerate("XYZ", 1):
        lines += [f"Channel-{k}: Accel-{axis}", f"Scale-{k}: {scale}"]
    texts = {
        b"ICRD": f"{start:%Y-%m-%d %H:%M:%S}.000",
        b"IART": "Id: 1234\nDevice: CWA\nRevision: 17\nFirmware: 44",
        b"ICMT": "\n".join([*lines, "Channel-4: Aux"]),
    }
    info = b"INFO"
    for kind, text in texts.items():
        body = text.encode() + b"\0"
        info += kind + struct.pack("<I", len(body)) + body + b"\0" * (len(body) % 2)
    gone, rows = set(missing), []
    for k, sample in enumerate(samples):
        aux = 0x0C00 | warm if warm and k % 10 == 0 else 0
        rows.append(struct.pack("<3hH", *sample, aux | (0x8000 if k in gone else 0)))
    data = b"".join(rows)
    form = struct.pack("<HHIIHH", 1, 4, rate, 8 * rate, 8, 16)
    out = b"WAVEfmt " + struct.pack("<I", len(form)) + form
    out += b"LIST" + struct.pack("<I", len(info)) + info
    out += b"data" + struct.pack("<I", len(data)) + data
    return b"RIFF" + struct.pack("<I", len(out)) + out
