"""Flight logs, byte by byte from their published formats: PX4's ULog (docs.px4.io, "ULog File
Format") and ArduPilot's DataFlash (libraries/AP_Logger/README.md)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Stamps = NDArray[np.int64]


def ulog(
    stamps: Stamps,
    acc: Array,
    gyro: Array,
    *,
    combined: bool = False,
    raw_every: int = 1,
    parameters: Mapping[str, float] = MappingProxyType({}),
    selected: tuple[int, int] | None = None,
) -> bytes:
    """Sensors (k, n, 3) at stamps (n,) in µs since boot; combined : the first, as the filter is
    fed, alone; raw_every : beyond 1, that beside one in so many of the raw samples; chips have the
    ids 1001, 1002, ... and their gyroscopes 2001, 2002, ...; parameters : stated at the start;
    selected : ids of the chip and the gyroscope that the filter is fed from."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", int(stamps[0])), message(b"B", bytes(40))]
    for name, value in parameters.items():
        whole = name.endswith(("_ID", "_ENABLE", "_ROT"))
        key = f"{'int32_t' if whole else 'float'} {name}".encode()
        packed = struct.pack("<i", int(value)) if whole else struct.pack("<f", value)
        out += [message(b"P", bytes([len(key)]) + key + packed)]
    fed = list[bytes]()
    fields = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out += [message(b"F", f"sensor_combined:{fields}".encode())]
    fields = (
        "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
    )
    out += [message(b"F", f"sensor_accel:{fields}float temperature;".encode())]
    out += [message(b"F", f"sensor_gyro:{fields}".encode())]
    if selected is not None:
        fields = "uint64_t timestamp;uint32_t accel_device_id;uint32_t gyro_device_id;"
        out += [message(b"F", f"sensor_selection:{fields}".encode())]
        out += [message(b"A", struct.pack("<BH", 0, 901) + b"sensor_selection")]
        fed += [message(b"D", struct.pack("<HQ2I", 901, int(stamps[0]), *selected))]
    if combined or raw_every > 1:
        out += [message(b"A", struct.pack("<BH", 0, 900) + b"sensor_combined")]
        rows = ((s, *g, *a) for s, g, a in zip(stamps, gyro[0], acc[0], strict=True))
        fed += [message(b"D", struct.pack("<HQ6f", 900, *row)) for row in rows]
        stamps, acc, gyro = stamps[::raw_every], acc[:, ::raw_every], gyro[:, ::raw_every]
    if combined:
        return b"".join([*out, *fed])
    for k, topic in enumerate(("sensor_accel", "sensor_gyro") * len(acc)):
        out += [message(b"A", struct.pack("<BH", k // 2, k) + topic.encode())]
    out += fed
    for n, stamp in enumerate(stamps):
        for k in range(len(acc)):
            head = (stamp + 700, stamp)
            out += [
                message(
                    b"D",
                    struct.pack("<HQQI4f", 2 * k, *head, 1001 + k, *acc[k, n], 30 + k + n / 1024),
                )
            ]
            out += [message(b"D", struct.pack("<HQQI3f", 2 * k + 1, *head, 2001 + k, *gyro[k, n]))]
    return b"".join(out)


def dataflash(
    stamps: Stamps,
    acc: Array,
    gyro: Array,
    *,
    old: bool = False,
    junk: bytes = b"",
    parameters: Iterable[tuple[str, float]] = (),
) -> bytes:
    """The same; old : numbered by name, not by a field; junk : bytes in the middle."""

    def fmt(kind: int, name: str, letters: str, names: str, size: int) -> bytes:
        text = (name.encode(), letters.encode(), names.encode())
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, *text)

    out = [fmt(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)]
    out += [fmt(90, "MODE", "QM", "TimeUS,Mode", 12)]
    if old:
        columns = "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,Temp"
        out += [fmt(100 + k, n, "Qfffffff", columns, 39) for k, n in enumerate(("IMU", "IMU2"))]
    else:
        columns = "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T"
        out += [fmt(100, "IMU", "QBfffffff", columns, 40)]
    out += [fmt(64, "PARM", "QNf", "TimeUS,Name,Value", 31)]
    out += [
        b"\xa3\x95\x40" + struct.pack("<Q16sf", int(stamps[0]), name.encode(), value)
        for name, value in parameters
    ]
    for n, stamp in enumerate(stamps):
        for k in range(len(acc)):
            values = (*gyro[k, n], *acc[k, n], 30 + k + n / 1024)
            head = struct.pack("<Q", stamp) if old else struct.pack("<QB", stamp, k)
            kind = bytes([100 + k]) if old else b"\x64"
            out += [b"\xa3\x95" + kind + head + struct.pack("<7f", *values)]
        # What a message holds may look like a header.
        out += [b"\xa3\x95\x5a" + b"\xa3\x95\x64" + bytes(6)]
        out += [junk] if n == len(stamps) // 2 else []
    return b"".join(out)
