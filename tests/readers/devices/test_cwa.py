"""Axivity's .cwa: both packings, the AX6, clocks, restarts, damage; and a measured file."""

from __future__ import annotations

import gzip
import hashlib
import zlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.units import DEG, STANDARD_GRAVITY
from worlds.logger_files import ax_file, ax_header, ax_sector
from worlds.places import MEASURED

START = datetime(2020, 2, 12, 9, 3, 37, tzinfo=UTC)


def counts(n: int, *, one_g: int = 256, axes: int = 3) -> np.ndarray:
    rng = np.random.default_rng(n)
    rest = np.zeros(axes, int)
    rest[-1] = one_g
    return rest + rng.integers(-40, 40, size=(n, axes))


def saved(folder: Path, data: bytes, name: str = "a.cwa") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("axes", "per_sector"), [(0x30, 120), (0x32, 80)])
def test_both_packings(axes: int, per_sector: int, tmp_path: Path) -> None:
    wanted = counts(1000)
    data = ax_file(wanted.tolist(), START, axes=axes, per_sector=per_sector)
    for path in (
        saved(tmp_path, data),
        saved(tmp_path, gzip.compress(data), "b.cwa.gz"),
    ):
        found = read(path)
        acc, warm = found.channels["imu0/acceleration"], found.channels["imu0/temperature"]
        np.testing.assert_allclose(acc.values, wanted / 256.0 * STANDARD_GRAVITY, rtol=1e-12)
        np.testing.assert_allclose(acc.t, np.arange(1000) / 100.0, atol=1e-9)
        assert found.start_ns == round(START.timestamp()) * 10**9
        assert set(warm.values[:, 0]) == {25.0}
        assert found.gaps == ()
        assert found.notes[0] == "Axivity AX3 4711"


@pytest.mark.parametrize(("hours", "gap"), [(1, "no samples"), (-1, "the clock was set back by")])
def test_a_logger_that_starts_again_loses_nothing(hours: int, gap: str, tmp_path: Path) -> None:
    wanted = counts(1200)
    wanted[7] = [4088, -4096, 8]  # ten bits hold it with an exponent of two
    second = ax_file(counts(1200).tolist(), START + timedelta(hours=hours))[1024:]
    found = read(saved(tmp_path, ax_file(wanted.tolist(), START) + second))
    channel = found.channels["imu0/acceleration"]
    assert channel.t.size == 2400
    assert (np.diff(channel.t) > 0).all()
    assert [g.reason[: len(gap)] for g in found.gaps] == [gap]
    np.testing.assert_allclose(channel.values[7] / STANDARD_GRAVITY, wanted[7] / 256)


def test_an_ax6_turns(tmp_path: Path) -> None:
    wanted = counts(400, one_g=4096, axes=6)
    scales = 4 << 13 | 2 << 10  # 1/2^12 g, 8000/2^2 deg/s
    data = ax_file(wanted.tolist(), START, axes=0x62, per_sector=40, scales=scales)
    found = read(saved(tmp_path, data))
    acc, gyro = found.channels["imu0/acceleration"], found.channels["imu0/angular_rate"]
    np.testing.assert_allclose(acc.values, wanted[:, 3:] / 4096 * STANDARD_GRAVITY)
    np.testing.assert_allclose(gyro.values, wanted[:, :3] * 2000 / 32768 * DEG)
    assert found.notes[0].startswith("Axivity AX6")


def test_a_sensor_that_is_slow_keeps_the_loggers_time(tmp_path: Path) -> None:
    true, wanted = 98.0, counts(2400)
    out = [ax_header()]
    for k in range(20):
        took = (120 * k + 120) / true  # the clock when the sector is full
        whole, fraction = int(took), int(took % 1 * 32768)
        at = 120 - int(fraction / 32768 * 100)  # as the device moves it, at the rate that it states
        when = START + timedelta(seconds=whole)
        part = wanted[120 * k : 120 * k + 120].tolist()
        out.append(ax_sector(part, when, number=k, at=at, fraction=max(1, fraction)))
    acc = read(saved(tmp_path, b"".join(out))).channels["imu0/acceleration"]
    assert np.diff(acc.t).min() > 0.99 / true
    assert np.diff(acc.t).max() < 1.01 / true
    assert acc.t[-1] == pytest.approx(2399 / true, abs=0.005)


@pytest.mark.parametrize("harm", ["flip", "insert", "remove"])
def test_damage_costs_its_sector(harm: str, tmp_path: Path) -> None:
    wanted = counts(2400)
    data = bytearray(ax_file(wanted.tolist(), START))
    at = 1024 + 5 * 512 + 100
    if harm == "flip":
        data[at] ^= 4
    elif harm == "insert":
        data[at:at] = b"seven.."
    else:
        del data[at : at + 7]
    path = saved(tmp_path, bytes(data))
    found = read(path)
    acc = found.channels["imu0/acceleration"].values / STANDARD_GRAVITY * 256
    np.testing.assert_allclose(acc, np.delete(wanted, range(600, 720), axis=0), atol=1e-9)
    assert len(found.gaps) == 1
    assert any("no sound sector" in note for note in found.notes)
    with pytest.raises(UnreadableInput, match="byte"):
        read(path, strict=True)


@pytest.mark.parametrize("packed", [False, True])
def test_a_file_of_no_sectors_ends_soon(packed: bool, tmp_path: Path) -> None:
    for filling in (b"AX\xfc\x01", bytes(4)):
        data = ax_header() + filling * (1 << 22)
        path = saved(tmp_path, gzip.compress(data, 1) if packed else data)
        with pytest.raises(UnreadableInput):
            read(path)


def test_a_measured_file_holds_what_another_reader_found() -> None:
    """Counts and times as scikit-digital-health 0.17.18 reads the same file (its own C code)."""
    acc = read(MEASURED / "ax3.cwa").channels["imu0/acceleration"]
    raw = np.rint(acc.values / STANDARD_GRAVITY * 256).astype("<i2")
    np.testing.assert_allclose(raw / 256 * STANDARD_GRAVITY, acc.values, rtol=1e-12)
    assert raw[:3].tolist() == [[-24, -52, 244], [-16, -12, 236], [-20, -12, 252]]
    assert hashlib.sha256(raw.tobytes()).hexdigest().startswith("8dd389e60c36a418")
    assert acc.t[-1] == pytest.approx(298.105, abs=0.02)


@pytest.mark.parametrize("harm", ["cut between sectors", "wrong checksum"])
def test_a_packing_that_breaks_off_is_told(harm: str, tmp_path: Path) -> None:
    data = ax_file(counts(1200).tolist(), START)
    packed = bytearray(gzip.compress(data[: 1024 + 5 * 512]))
    if harm == "wrong checksum":
        packed[-6] ^= 1
    else:  # a stream that ends at a sector, without the end mark of gzip
        squeeze = zlib.compressobj(wbits=31)
        packed = bytearray(squeeze.compress(data[: 1024 + 5 * 512]))
        packed += squeeze.flush(zlib.Z_FULL_FLUSH)
    path = saved(tmp_path, bytes(packed), "a.cwa.gz")
    found = read(path)
    assert found.channels["imu0/acceleration"].t.size >= 480
    assert any("breaks off" in note for note in found.notes)
    with pytest.raises(UnreadableInput, match="breaks off"):
        read(path, strict=True)
