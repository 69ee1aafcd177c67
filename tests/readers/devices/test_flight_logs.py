"""Flight logs, byte by byte from their published formats: PX4's ULog (docs.px4.io, "ULog File
Format") and ArduPilot's DataFlash (libraries/AP_Logger/README.md)."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import read

N = 400
RNG = np.random.default_rng(3)
ACC = np.float32(np.array([0.3, -0.2, -9.8]) + RNG.normal(scale=0.05, size=(2, N, 3)))
GYRO = np.float32(RNG.normal(scale=0.01, size=(2, N, 3)))
STAMPS = 5_000_000 + 4000 * np.arange(N)  # µs since boot


def ulog(path: Path, *, combined: bool = False) -> Path:
    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    out = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000), message(b"B", bytes(40))]
    if combined:
        fields = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
        out += [message(b"F", f"sensor_combined:{fields}".encode())]
        out += [message(b"A", struct.pack("<BH", 0, 0) + b"sensor_combined")]
        rows = ((s, *g, *a) for s, g, a in zip(STAMPS, GYRO[0], ACC[0], strict=True))
        out += [message(b"D", struct.pack("<HQ6f", 0, *row)) for row in rows]
    else:
        fields = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;"
        out += [message(b"F", f"sensor_accel:{fields}float temperature;".encode())]
        out += [message(b"F", f"sensor_gyro:{fields}".encode())]
        for k, topic in enumerate(("sensor_accel", "sensor_gyro") * 2):
            out += [message(b"A", struct.pack("<BH", k // 2, k) + topic.encode())]
        for n, stamp in enumerate(STAMPS):
            for k in range(2):
                head = (stamp + 700, stamp)
                out += [message(b"D", struct.pack("<HQQ4f", 2 * k, *head, *ACC[k, n], 30 + k))]
                out += [message(b"D", struct.pack("<HQQ3f", 2 * k + 1, *head, *GYRO[k, n]))]
    path.write_bytes(b"".join(out))
    return path


def dataflash(path: Path, *, old: bool = False, junk: bytes = b"") -> Path:
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
    for n, stamp in enumerate(STAMPS):
        for k in range(2):
            values = (*GYRO[k, n], *ACC[k, n], 30 + k)
            head = struct.pack("<Q", stamp) if old else struct.pack("<QB", stamp, k)
            kind = bytes([100 + k]) if old else b"\x64"
            out += [b"\xa3\x95" + kind + head + struct.pack("<7f", *values)]
        # What a message holds may look like a header.
        out += [b"\xa3\x95\x5a" + b"\xa3\x95\x64" + bytes(6)]
        out += [junk] if n == N // 2 else []
    path.write_bytes(b"".join(out))
    return path


@pytest.mark.parametrize("old", [False, True])
def test_every_imu_of_a_dataflash_log(old: bool, tmp_path: Path) -> None:
    found = read(dataflash(tmp_path / "1.bin", old=old), strict=True)
    _both(found)
    assert found.format == "dataflash"


def test_every_sensor_of_a_px4_log(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    found = read(ulog(tmp_path / "1.ulg"), strict=True)
    _both(found)
    assert found.format == "ulog"


def test_a_px4_log_of_the_filters_input_only(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    found = read(ulog(tmp_path / "1.ulg", combined=True))
    assert sorted(found.channels) == ["imu0/acceleration", "imu0/angular_rate"]
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, ACC[0])


def test_bytes_of_no_message_cost_only_themselves(tmp_path: Path) -> None:
    path = dataflash(tmp_path / "1.bin", junk=b"\xa3\x95\x64" + bytes(3) + b"lost")
    found = read(path)
    # The message before them has no other at its end; all others are as written.
    assert any("belong to no message" in note for note in found.notes)
    values = found.channels["imu1/acceleration"].values
    assert len(values) >= N - 2
    assert all(any(np.array_equal(v, a) for a in ACC[1]) for v in values)
    with pytest.raises(UnreadableInput, match="belong to no message"):
        read(path, strict=True)


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.98])
def test_a_flight_log_that_is_cut(share: float, tmp_path: Path) -> None:
    path = dataflash(tmp_path / "1.bin")
    path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])
    try:
        found = read(path)
    except UnreadableInput:
        assert share < 0.1
        return
    n = len(found.channels["imu0/acceleration"].values)
    np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, ACC[0, :n])
    assert 0 < n < N


def _both(found) -> None:  # type: ignore[no-untyped-def]
    for k in range(2):
        acc, gyro = (found.channels[f"imu{k}/{q}"] for q in ("acceleration", "angular_rate"))
        np.testing.assert_array_equal(acc.values, ACC[k])
        np.testing.assert_array_equal(gyro.values, GYRO[k])
        np.testing.assert_allclose(acc.t, STAMPS / 1e6, atol=1e-9)
        np.testing.assert_allclose(found.channels[f"imu{k}/temperature"].values, 30 + k)
    assert acc.rate == pytest.approx(250.0)
