"""GENEActiv's .bin: calibration, clock, gaps, damage; and a measured file."""

from __future__ import annotations

import gzip
import hashlib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import read
from imucalib.units import STANDARD_GRAVITY
from worlds.logger_files import gene_file, gene_page
from worlds.places import MEASURED

START = datetime(2020, 5, 21, 16, 16, 43, tzinfo=UTC)
GAIN, OFFSET = np.array([25522.0, 25457.0, 24829.0]), np.array([272.0, -1129.0, 101.0])


def counts(n: int) -> np.ndarray:
    rng = np.random.default_rng(n)
    return np.array([0, -255, 3]) + rng.integers(-40, 40, size=(n, 3))


def saved(folder: Path, data: bytes) -> Path:
    path = folder / "a.bin"
    path.write_bytes(data)
    return path


def test_values_clock_and_temperature(tmp_path: Path) -> None:
    wanted = counts(1500)
    data = gene_file(wanted.tolist(), START)
    for path in (saved(tmp_path, data), saved(tmp_path, gzip.compress(data))):
        found = read(path)
        acc, warm = found.channels["imu0/acceleration"], found.channels["imu0/temperature"]
        g = (100 * wanted - OFFSET) / GAIN
        np.testing.assert_allclose(acc.values, g * STANDARD_GRAVITY, rtol=1e-12)
        np.testing.assert_allclose(acc.t, np.arange(1500) / 50.0, atol=1e-9)
        assert found.start_ns == (round(START.timestamp()) - 7200) * 10**9  # the clock is at +02:00
        np.testing.assert_allclose(warm.values[:, 0], 20 + np.arange(5) / 10)
        assert found.gaps == ()


def test_pages_that_do_not_follow_leave_a_gap(tmp_path: Path) -> None:
    wanted = counts(600)
    late = gene_page(wanted[300:].tolist(), START + timedelta(seconds=6.5), number=1, rate=50.0)
    found = read(saved(tmp_path, gene_file(wanted[:300].tolist(), START) + late))
    assert [(g.start, g.stop) for g in found.gaps] == [(pytest.approx(5.98), pytest.approx(6.5))]


@pytest.mark.parametrize("harm", ["digit", "cut line", "stamp", "frequency"])
def test_a_damaged_page_costs_itself(harm: str, tmp_path: Path) -> None:
    data = gene_file(counts(1500).tolist(), START)
    head, *pages = data.split(b"Recorded Data")
    broken = {
        "digit": pages[2][:-50] + b"q" + pages[2][-49:],
        "cut line": pages[2][:-600] + b"\n",
        "stamp": pages[2].replace(b"Page Time:2020", b"Page Time:20x0"),
        "frequency": pages[2].replace(b"Frequency:50.0", b"Frequency:-1"),
    }[harm]
    pages[2] = broken
    path = saved(tmp_path, b"Recorded Data".join([head, *pages]))
    found = read(path)
    assert found.channels["imu0/acceleration"].t.size == 1200
    assert any("1 pages left out; page 3" in note for note in found.notes)
    assert len(found.gaps) == 1
    with pytest.raises(UnreadableInput, match="page 3"):
        read(path, strict=True)


def test_a_header_without_its_calibration_is_refused(tmp_path: Path) -> None:
    data = gene_file(counts(300).tolist(), START).replace(b"y gain:25457", b"y gain:0")
    with pytest.raises(UnreadableInput, match="gain and offset"):
        read(saved(tmp_path, data))
    with pytest.raises(UnreadableInput):
        read(saved(tmp_path, b"Device Identity\nDevice Unique Serial Code:1\n"))


def test_a_file_without_pages_ends_soon(tmp_path: Path) -> None:
    with pytest.raises(UnreadableInput, match="no pages"):
        read(saved(tmp_path, b"Device Identity\n" + bytes(40 << 20)))


def test_a_measured_file_holds_what_another_reader_found() -> None:
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
    data = gene_file(counts(1500).tolist(), START)
    cut = data[: data.rindex(b"Recorded Data")]
    packed = gzip.compress(data)
    half = packed[: len(packed) // 2]
    for some, words in ((cut, "states 5 pages, 4 were found"), (half, "breaks off")):
        path = saved(tmp_path, some)
        assert any(words in note for note in read(path).notes)
        with pytest.raises(UnreadableInput, match=words):
            read(path, strict=True)
