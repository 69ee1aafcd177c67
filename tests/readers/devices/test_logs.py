"""Axivity's and GENEActiv's own files: packings, clocks, restarts, damage."""

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
from worlds.logger_files import ax_file, ax_header, ax_sector, gene_file, gene_page
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


GENEACTIV_BIN_START = datetime(2020, 5, 21, 16, 16, 43, tzinfo=UTC)


GAIN, OFFSET = np.array([25522.0, 25457.0, 24829.0]), np.array([272.0, -1129.0, 101.0])


def geneactiv_bin_counts(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    return np.array([0, -255, 3]) + rng.integers(-40, 40, size=(n, 3))


def geneactiv_bin_saved(folder: Path, data: bytes) -> Path:
    path = folder / "a.bin"
    path.write_bytes(data)
    return path


def test_values_clock_and_temperature(tmp_path: Path) -> None:
    wanted = geneactiv_bin_counts(1500)
    data = gene_file(wanted.tolist(), GENEACTIV_BIN_START)
    for path in (
        geneactiv_bin_saved(tmp_path, data),
        geneactiv_bin_saved(tmp_path, gzip.compress(data)),
    ):
        found = read(path)
        acc, warm = found.channels["imu0/acceleration"], found.channels["imu0/temperature"]
        g = (100 * wanted - OFFSET) / GAIN
        np.testing.assert_allclose(acc.values, g * STANDARD_GRAVITY, rtol=1e-12)
        np.testing.assert_allclose(acc.t, np.arange(1500) / 50.0, atol=1e-9)
        assert (
            found.start_ns == (round(GENEACTIV_BIN_START.timestamp()) - 7200) * 10**9
        )  # the clock is at +02:00
        np.testing.assert_allclose(warm.values[:, 0], 20 + np.arange(5) / 10)
        assert found.gaps == ()


def test_pages_that_do_not_follow_leave_a_gap(tmp_path: Path) -> None:
    wanted = geneactiv_bin_counts(600)
    late = gene_page(
        wanted[300:].tolist(), GENEACTIV_BIN_START + timedelta(seconds=6.5), number=1, rate=50.0
    )
    found = read(
        geneactiv_bin_saved(tmp_path, gene_file(wanted[:300].tolist(), GENEACTIV_BIN_START) + late)
    )
    assert [(g.start, g.stop) for g in found.gaps] == [(pytest.approx(5.98), pytest.approx(6.5))]


@pytest.mark.parametrize("harm", ["digit", "cut line", "stamp", "frequency"])
def test_a_damaged_page_costs_itself(harm: str, tmp_path: Path) -> None:
    data = gene_file(geneactiv_bin_counts(1500).tolist(), GENEACTIV_BIN_START)
    head, *pages = data.split(b"Recorded Data")
    broken = {
        "digit": pages[2][:-50] + b"q" + pages[2][-49:],
        "cut line": pages[2][:-600] + b"\n",
        "stamp": pages[2].replace(b"Page Time:2020", b"Page Time:20x0"),
        "frequency": pages[2].replace(b"Frequency:50.0", b"Frequency:-1"),
    }[harm]
    pages[2] = broken
    path = geneactiv_bin_saved(tmp_path, b"Recorded Data".join([head, *pages]))
    found = read(path)
    assert found.channels["imu0/acceleration"].t.size == 1200
    assert any("1 pages left out; page 3" in note for note in found.notes)
    assert len(found.gaps) == 1
    with pytest.raises(UnreadableInput, match="page 3"):
        read(path, strict=True)


def test_a_header_without_its_calibration_is_refused(tmp_path: Path) -> None:
    data = gene_file(geneactiv_bin_counts(300).tolist(), GENEACTIV_BIN_START).replace(
        b"y gain:25457", b"y gain:0"
    )
    with pytest.raises(UnreadableInput, match="gain and offset"):
        read(geneactiv_bin_saved(tmp_path, data))
    with pytest.raises(UnreadableInput):
        read(geneactiv_bin_saved(tmp_path, b"Device Identity\nDevice Unique Serial Code:1\n"))


def test_a_file_without_pages_ends_soon(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput, match="no pages"):
        read(geneactiv_bin_saved(tmp_path, b"Device Identity\n" + bytes(40 << 20)))


def test_a_measured_file_holds_what_another_reader_found_of_geneactiv_bin() -> None:
    """Values and times as scikit-digital-health 0.17.18 reads the same file (its own C code)."""
    found = read(MEASURED / "geneactiv.bin")
    acc = found.channels["imu0/acceleration"]
    g = acc.values / STANDARD_GRAVITY
    first = [[-0.88049526, 0.19754881, 0.04023521], [-0.82172244, 0.24075893, 0.0724556]]
    np.testing.assert_allclose(g[:2], first, atol=5e-9)
    raw = np.rint((g * GAIN + OFFSET) / 100).astype("<i2")
    assert hashlib.sha256(raw.tobytes()).hexdigest().startswith("ad3c2a31de45c592")
    assert acc.t[[300, -1]].tolist() == pytest.approx([6.5, 18.48])
    assert found.channels["imu0/temperature"].values[[0, -1], 0].tolist() == [28.2, 29.1]


def test_a_file_that_ends_too_early_is_told(tmp_path: Path) -> None:
    data = gene_file(geneactiv_bin_counts(1500).tolist(), GENEACTIV_BIN_START)
    cut = data[: data.rindex(b"Recorded Data")]
    packed = gzip.compress(data)
    half = packed[: len(packed) // 2]
    for some, words in ((cut, "states 5 pages, 4 were found"), (half, "breaks off")):
        path = geneactiv_bin_saved(tmp_path, some)
        assert any(words in note for note in read(path).notes)
        with pytest.raises(UnreadableInput, match=words):
            read(path, strict=True)
