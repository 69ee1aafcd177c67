"""ActiGraph's older archives: the maker's own example, an odd end, damage, a bomb."""

from __future__ import annotations

import io
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import blocks, read
from imucalib.recording.mapping import FieldMapping
from imucalib.units import STANDARD_GRAVITY
from worlds.logger_files import old_gt3x

START = datetime(2011, 10, 26, 9, 0, tzinfo=UTC)


def counts(n: int) -> np.ndarray:
    return np.array([5, 7, 341]) + np.random.default_rng(n).integers(-9, 9, size=(n, 3))


def saved(folder: Path, data: bytes) -> Path:
    path = folder / "a.gt3x"
    path.write_bytes(data)
    return path


def test_the_makers_example(tmp_path: Path) -> None:
    """The three samples that ActiGraph's description of activity.bin works out."""
    path = saved(tmp_path, old_gt3x([], START))
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("info.txt", "Sample Rate: 30\nStart Date: 634556532600000000\n")
        file.writestr("activity.bin", bytes.fromhex("006008EBD007009EBF007008EBF0"))
    found = read(path, FieldMapping(acc_unit="g"))
    g = found.channels["imu0/acceleration"].values / STANDARD_GRAVITY
    wanted = [[0.023, 0.018, -0.947], [0.026, 0.021, -0.941], [0.023, 0.021, -0.947 + 0.006]]
    np.testing.assert_allclose(g, wanted, atol=0.0006)


@pytest.mark.parametrize("n", [900, 901])
def test_values_times_and_blocks(n: int, tmp_path: Path) -> None:
    wanted = counts(n)
    path = saved(tmp_path, old_gt3x(wanted.tolist(), START))
    found = read(path)
    acc = found.channels["imu0/acceleration"]
    np.testing.assert_allclose(acc.values, wanted / 341.0 * STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(acc.t, np.arange(n) / 30.0, atol=1e-9)
    assert found.start_ns == round(START.timestamp()) * 10**9
    assert found.gaps == ()
    assert "ActiGraph NEO1C16110020, 30 Hz, 341 counts a g" in found.notes
    parts = [b.channels["imu0/acceleration"] for b in blocks(path, block_samples=100)]
    assert len(parts) > 5
    np.testing.assert_array_equal(np.concatenate([p.values for p in parts]), acc.values)
    np.testing.assert_allclose(np.concatenate([p.t for p in parts]), acc.t, atol=1e-9)


def test_a_flipped_bit_is_told(tmp_path: Path) -> None:
    data = bytearray(old_gt3x(counts(900).tolist(), START))
    data[data.index(b"activity.bin") + 400] ^= 1
    path = saved(tmp_path, bytes(data))
    with pytest.raises(UnreadableInput):
        read(path, strict=True)
    try:
        notes = read(path).notes
    except UnreadableInput as error:
        notes = (str(error),)
    assert any("breaks off" in note or "no samples" in note for note in notes), notes


class _Pipe(io.BytesIO):
    """What cannot be written again: zipfile puts sizes and checksums behind each member."""

    def seekable(self) -> bool:
        return False

    def seek(self, *where: int) -> int:
        raise OSError


def _archive(activity: bytes, method: int, *, piped: bool) -> bytes:
    out = _Pipe() if piped else io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as file:
        file.writestr("info.txt", "Sample Rate: 30\nStart Date: 634556532600000000\n")
        file.writestr("activity.bin", activity)
        file.writestr("lux.bin", b"")
    return out.getvalue()


@pytest.mark.parametrize(
    ("method", "piped"),
    [(zipfile.ZIP_STORED, False), (zipfile.ZIP_DEFLATED, False), (zipfile.ZIP_DEFLATED, True)],
)
def test_a_lost_directory_is_told_and_the_checksum_holds(
    method: int, piped: bool, tmp_path: Path
) -> None:
    data = _archive(np.random.default_rng(0).bytes(9 * 400), method, piped=piped)
    directory = data.index(b"PK\x01\x02")
    whole, cut = (read(saved(tmp_path, d)) for d in (data, data[:directory]))
    assert any("lost its directory" in note for note in cut.notes)
    assert not any("breaks off" in note for note in cut.notes)
    one, other = (r.channels["imu0/acceleration"].values for r in (whole, cut))
    np.testing.assert_array_equal(one, other)
    with pytest.raises(UnreadableInput, match="no directory"):
        read(path := saved(tmp_path, data[:directory]), strict=True)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        crc = archive.getinfo("activity.bin").CRC.to_bytes(4, "little")
    path.write_bytes(data[:directory].replace(crc, b"\x5a" * 4))
    assert any("checksum" in note for note in read(path).notes)


@pytest.mark.parametrize("line", ["Start Date: 9e9", f"Start Date: {10**40}", "Sample Rate: inf"])
def test_nonsense_in_info_is_refused(line: str, tmp_path: Path) -> None:
    path = tmp_path / "a.gt3x"
    with zipfile.ZipFile(path, "w") as file:
        rows = {"Sample Rate": "30", "Start Date": "634556532600000000"}
        name, _, value = line.partition(": ")
        rows[name] = value
        file.writestr("info.txt", "".join(f"{k}: {v}\n" for k, v in rows.items()))
        file.writestr("activity.bin", bytes.fromhex("006008EBD007009EBF007008EBF0"))
    with pytest.raises(UnreadableInput, match=r"sample rate|start date"):
        read(path)
