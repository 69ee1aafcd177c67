"""Flight logs of PX4 and ArduPilot, as `worlds.flight_logs` writes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imucalib.errors import UnreadableInput
from imucalib.readers import read
from worlds import flight_logs

N = 400
RNG = np.random.default_rng(3)
ACC = np.float32(np.array([0.3, -0.2, -9.8]) + RNG.normal(scale=0.05, size=(2, N, 3)))
GYRO = np.float32(RNG.normal(scale=0.01, size=(2, N, 3)))
STAMPS = 5_000_000 + 4000 * np.arange(N)  # µs since boot


def ulog(path: Path, *, combined: bool = False) -> Path:
    path.write_bytes(flight_logs.ulog(STAMPS, ACC, GYRO, combined=combined))
    return path


def dataflash(path: Path, *, old: bool = False, junk: bytes = b"") -> Path:
    path.write_bytes(flight_logs.dataflash(STAMPS, ACC, GYRO, old=old, junk=junk))
    return path


@pytest.mark.parametrize("old", [False, True])
def test_every_imu_of_a_dataflash_log(old: bool, tmp_path: Path) -> None:
    found = read(dataflash(tmp_path / "1.bin", old=old), strict=True)
    _both(found)
    assert found.format == "dataflash"


@pytest.mark.parametrize("combined", [False, True])
def test_a_px4_log_has_every_sensor_or_what_the_filter_was_fed(
    combined: bool, tmp_path: Path
) -> None:
    pytest.importorskip("pyulog")
    found = read(ulog(tmp_path / "1.ulg", combined=combined), strict=True)
    assert found.format == "ulog"
    if combined:
        assert sorted(found.channels) == ["imu0/acceleration", "imu0/angular_rate"]
        np.testing.assert_array_equal(found.channels["imu0/acceleration"].values, ACC[0])
    else:
        _both(found)


def test_a_damaged_px4_log_is_told_in_notes_not_on_stdout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = ulog(tmp_path / "1.ulg")
    data = bytearray(path.read_bytes())
    at = data.rindex(b"D\x01\x00")  # a message of an unknown number
    data[at + 1 : at + 3] = b"\xff\x3f"
    path.write_bytes(bytes(data))
    found = read(path)
    assert any("damaged" in note for note in found.notes)
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(("raw_every", "read_from"), [(200, 0), (2, 1)])
def test_px4_sensors_that_are_thinned_out_give_way_to_what_the_filter_was_fed(
    raw_every: int, read_from: int, tmp_path: Path
) -> None:
    pytest.importorskip("pyulog")
    path = tmp_path / "1.ulg"
    path.write_bytes(flight_logs.ulog(STAMPS, ACC, GYRO, raw_every=raw_every))
    found = read(path, strict=False)
    channel = found.channels["imu0/acceleration"]
    every = (1, raw_every)[read_from]
    np.testing.assert_array_equal(channel.values, ACC[0][::every])
    said = [n for n in found.notes if "sensor_accel 0 (1" in n and "sensor_combined" in n]
    assert bool(said) == (read_from == 0)


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


def _both(found) -> None:  # type: ignore[no-untyped-def]
    for k in range(2):
        acc, gyro = (found.channels[f"imu{k}/{q}"] for q in ("acceleration", "angular_rate"))
        np.testing.assert_array_equal(acc.values, ACC[k])
        np.testing.assert_array_equal(gyro.values, GYRO[k])
        np.testing.assert_allclose(acc.t, STAMPS / 1e6, atol=1e-9)
        warm = found.channels[f"imu{k}/temperature"].values[:, 0]
        np.testing.assert_allclose(warm, 30 + k + np.arange(N) / 1024)
    assert acc.rate == pytest.approx(250.0)
