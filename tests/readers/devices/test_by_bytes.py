"""A device is known by its bytes, not by a name's ending; what its format fixes is no guess."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping
from imucalib.units import STANDARD_GRAVITY
from worlds.logger_files import ax_file, gene_file, old_gt3x, wav_file
from worlds.places import DATA, needs_data

WHEN = datetime(2021, 3, 4, 5, 6, 7, tzinfo=UTC)
RNG = np.random.default_rng(5)


def _moved(scale: float, count: int = 3000) -> list[tuple[int, ...]]:
    """Counts of a sensor that is never at rest, nor near 1 g."""
    values = scale * (RNG.normal(0.0, 0.8, (count, 3)) + np.array([3.0, 2.5, 2.5]))
    return [tuple(map(int, row)) for row in values]


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.bin", b"GENEA\r\nVersion:1\r\n\r\n" + bytes(4096), "GENEA.*readGenea"),
        ("a.cwa", b"GENEA\r\nVersion:1\r\n\r\n" + bytes(4096), "GENEA.*readGenea"),
        ("a.bin", bytes(512) + b"MDTC" + bytes(4096), "Matrix.*readParmayMatrix"),
        ("A.BIN", b"remarks".ljust(512) + b"MDTC" + bytes(4096), "Matrix.*readParmayMatrix"),
        ("a.bin", bytes(4096), "the format is not known"),
        ("a.bin", b"\x7fELF" + bytes(4096), "this is a program"),
    ],
)
def test_a_file_that_is_not_read_is_called_by_its_true_name(
    name: str, content: bytes, words: str, tmp_path: Path
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(UnreadableInput, match=words) as caught:
        read(path)
    assert "LOG_BITMASK" not in str(caught.value)


@pytest.mark.parametrize("size", [130, 700, 1 << 18])
@pytest.mark.parametrize("name", ["cwa", "geneactiv", "gt3x activity", "wav"])
def test_blocks_do_not_matter(name: str, size: int, tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(_logs()[name])
    whole = read(path).channels["imu0/acceleration"]
    parts = [b.channels["imu0/acceleration"] for b in blocks(path, block_samples=size)]
    np.testing.assert_array_equal(np.concatenate([p.values for p in parts]), whole.values)
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), whole.t, atol=1e-9)


def _logs() -> dict[str, bytes]:
    """A log of every device whose format fixes its unit."""
    return {
        "cwa": ax_file(_moved(256.0), WHEN, axes=0x32, per_sector=80),
        "geneactiv": gene_file(_moved(256.0), WHEN, rate=50.0),
        "gt3x activity": old_gt3x(_moved(250.0), WHEN),
        "wav": wav_file(_moved(3500.0), WHEN),
    }


@pytest.mark.parametrize("name", _logs())
@pytest.mark.parametrize("ending", ["", ".bin", ".csv", ".dat"])
def test_what_a_format_fixes_is_never_refused_by_a_guess(
    name: str, ending: str, tmp_path: Path
) -> None:
    path = tmp_path / f"log{ending}"
    path.write_bytes(_logs()[name])
    found = read(path)
    assert found.format == name
    channel = found.channels["imu0/acceleration"]
    assert channel.unit == "m/s2"
    assert np.median(np.linalg.norm(channel.values, axis=1)) > 3.0 * STANDARD_GRAVITY
    assert any("the format fixes the unit" in note for note in found.notes)


@pytest.mark.parametrize("rate", [25.0, 50.0, 100.0, 200.0])
@pytest.mark.parametrize("share", [1, 3])
def test_sectors_without_a_rate_take_that_of_their_stamps(
    rate: float, share: int, tmp_path: Path
) -> None:
    samples = [(0, 0, 256)] * 12_000
    code = 15 - round(np.log2(3200.0 / rate))
    whole = ax_file(samples, WHEN, rate=rate, code=0x40 | code)
    sectors = [whole[k : k + 512] for k in range(1024, len(whole), 512)]
    blind = ax_file(samples, WHEN, rate=rate, code=0x40)
    others = [blind[k : k + 512] for k in range(1024, len(blind), 512)]
    mixed = [
        o if k % share == 0 else s for k, (s, o) in enumerate(zip(sectors, others, strict=True))
    ]
    path = tmp_path / "a.cwa"
    path.write_bytes(whole[:1024] + b"".join(mixed))
    t = read(path).channels["imu0/acceleration"].t
    np.testing.assert_allclose(t, np.arange(12_000) / rate, atol=0.6 / rate)
    assert not read(path).gaps


def test_a_wave_file_of_omconvert(tmp_path: Path) -> None:
    samples = [tuple(map(int, row)) for row in RNG.normal([0, 0, 4096], 20.0, (1000, 3))]
    path = tmp_path / "a.wav"
    path.write_bytes(wav_file(samples, WHEN, rate=100, warm=270, missing=range(300, 400)))
    found = read(path, strict=True)
    channel = found.channels["imu0/acceleration"]
    there = np.r_[0:300, 400:1000]
    true = np.array(samples)[there] / 4096.0 * STANDARD_GRAVITY
    np.testing.assert_allclose(channel.values, true, rtol=1e-12)
    np.testing.assert_allclose(channel.t, there / 100.0, atol=1e-9)
    assert [(round(g.start, 2), round(g.stop, 2)) for g in found.gaps] == [(2.99, 4.0)]
    assert found.start_ns == int(WHEN.timestamp()) * 10**9
    assert found.channels["imu0/temperature"].values[0, 0] == pytest.approx(270 * 75 / 256 - 50)
    joined = [b.channels["imu0/acceleration"].values for b in blocks(path, block_samples=130)]
    assert len(joined) > 4
    np.testing.assert_array_equal(np.concatenate(joined), channel.values)


def test_a_wave_file_that_was_cut_gives_what_comes_before(tmp_path: Path) -> None:
    whole = wav_file([(0, 0, 4096)] * 1000, WHEN)
    path = tmp_path / "a.wav"
    path.write_bytes(whole[:-4000])
    found = read(path)
    assert found.channels["imu0/acceleration"].t.size == 500
    assert any("1000 samples, 500 were found" in note for note in found.notes)
    with pytest.raises(UnreadableInput, match="8000 bytes"):
        read(path, strict=True)


@needs_data
@pytest.mark.parametrize("name", ["skdh_ax3_sample.cwa", "skdh_gnactv_sample.bin"])
def test_a_measured_log_under_another_name(name: str, tmp_path: Path) -> None:
    other = tmp_path / "renamed.dat"
    other.write_bytes((DATA / "actigraph" / name).read_bytes())
    mapping = FieldMapping()
    one, two = read(DATA / "actigraph" / name, mapping), read(other, mapping)
    assert one.format == two.format
    for key, channel in one.channels.items():
        np.testing.assert_array_equal(two.channels[key].values, channel.values)
