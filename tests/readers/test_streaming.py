"""Correcting a recording block by block: the same numbers as at once, in the memory of a block."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imucalib import readers
from imucalib.calibration import apply as application
from imucalib.calibration.apply import apply_to_recording, correct_file
from imucalib.calibration.calibration import Calibration, StoredParameter
from imucalib.errors import UsageError
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write, write_blocks

CALIBRATION = Calibration(
    calibrator="lab",
    parameters=tuple(
        StoredParameter(f"bias_{a}", "bias", "sensor", v, 0.1, "mg")
        for a, v in zip("xyz", (20.0, -35.0, 5.0), strict=True)
    ),
    covariance=np.eye(3) * 0.01,
    raw_unit="m/s2",
    raw_to_si=1.0,
    gravity=9.80665,
    status="ok",
)


def recording(n: int, first: int = 0) -> Recording:
    t = (first + np.arange(n)) / 100.0
    values = 9.8 * np.stack([np.sin(t), np.cos(t), 0.01 * np.ones(n)], axis=1)
    warm = Channel(t, 20.0 + 0.0 * t[:, None], "degC", "temperature", "imu0", 100.0)
    acceleration = Channel(t, values, "m/s2", "acceleration", "imu0", 100.0)
    channels = {"imu0/acceleration": acceleration, "imu0/temperature": warm}
    return Recording(channels, "made", "made", "", start_ns=1_700_000_000_000_000_000)


@pytest.mark.parametrize("source", ["a.csv", "a.h5", "a.mcap"])
@pytest.mark.parametrize("target", ["b.csv", "b.h5", "b.mcap"])
def test_block_by_block_is_the_same(
    tmp_path: Path, source: str, target: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = lambda path, mapping, strict: readers.blocks(  # noqa: E731
        path, mapping, block_samples=97, strict=strict
    )
    monkeypatch.setattr(application, "blocks", small)
    write(recording(1000), tmp_path / source)
    correct_file(CALIBRATION, tmp_path / source, tmp_path / target, FieldMapping())
    at_once = apply_to_recording(CALIBRATION, readers.read(tmp_path / source))
    back = readers.read(tmp_path / target)
    assert set(back.channels) == set(at_once.channels)
    for name, channel in at_once.channels.items():
        np.testing.assert_array_equal(back.channels[name].values, channel.values)
        np.testing.assert_allclose(back.channels[name].t, channel.t, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".h5", ".csv", ".mcap"])
def test_memory_is_that_of_a_block(tmp_path: Path, suffix: str) -> None:
    def peak(blocks: int) -> int:
        tracemalloc.start()
        try:
            parts = (recording(5000, 5000 * k) for k in range(blocks))
            write_blocks(parts, tmp_path / f"a{suffix}")
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(2)
    assert peak(24) < 1.1 * peak(6)


@pytest.mark.parametrize("suffix", [".csv", ".mcap"])
def test_channels_that_change_do_not_fit_a_table(tmp_path: Path, suffix: str) -> None:
    one, two = recording(10), recording(10, 10)
    less = replace(one, channels={"imu0/acceleration": one.channels["imu0/acceleration"]})
    with pytest.raises(UsageError, match="channels change"):
        write_blocks([less, two], tmp_path / f"a{suffix}")
    assert not (tmp_path / f"a{suffix}").exists()
    for kind in (suffix, ".h5"):
        write_blocks([one, replace(two, channels=less_of(two))], tmp_path / f"b{kind}")
        back = readers.read(tmp_path / f"b{kind}")
        assert back.channels["imu0/acceleration"].t.size == 20
        assert back.channels["imu0/temperature"].t.size == 10


def less_of(whole: Recording) -> dict[str, Channel]:
    return {"imu0/acceleration": whole.channels["imu0/acceleration"]}
