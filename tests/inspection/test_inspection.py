"""An inspection tells what is in a recording, in one pass, also when something is missing."""

import numpy as np
import pytest

from imucalib import readers, writers
from imucalib.inspection.inspection import inspect_recording
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.units import STANDARD_GRAVITY

RATE = 100.0


def recording(unit: str = "m/s2") -> Recording:
    rng = np.random.default_rng(4)
    parts = []
    for k in range(4):
        rest = np.zeros(3)
        rest[k % 3] = STANDARD_GRAVITY
        parts.append(np.tile(rest, (500, 1)))
        parts.append(rng.normal(scale=4.0, size=(100, 3)))
    values = np.concatenate(parts) + rng.normal(scale=0.01, size=(2400, 3))
    t = np.arange(2400) / RATE
    t[1200:] += 3.0
    t[50] = t[49]
    gyro = rng.normal([0.02, 0.0, 0.0], 0.001, (2400, 3))
    channels = {
        "imu0/acceleration": Channel(t, values, unit, "acceleration", "imu0", RATE),
        "imu0/angular_rate": Channel(t, gyro, "rad/s", "angular_rate", "imu0", RATE),
    }
    gap = Gap(float(t[1199]), float(t[1200]), "no samples")
    return Recording(
        channels=channels,
        path="f",
        format="made",
        sha256="ab",
        start_ns=5,
        gaps=(gap,),
        notes=("a note",),
        mapping={"acc": ["x"]},
    )


def test_facts() -> None:
    found = inspect_recording([recording()])
    acc, gyro = found.channels
    assert (acc.samples, acc.unit, acc.clock.duplicates, acc.clock.back_steps) == (
        2400,
        "m/s2",
        1,
        0,
    )
    assert acc.clock.rate == pytest.approx(RATE)
    assert acc.clock.longest_step == pytest.approx(3.01)
    assert acc.clock.jitter < 1e-9
    assert acc.norm_at_rest == pytest.approx(STANDARD_GRAVITY, rel=1e-3)
    np.testing.assert_allclose(acc.noise, 0.01, rtol=0.1)
    assert gyro.norm_at_rest == pytest.approx(0.02, rel=0.05)
    assert found.span == pytest.approx(2399 / RATE + 3.0)
    assert found.gap_count == 1
    assert found.gap_seconds == pytest.approx(3.01)
    assert found.still is not None
    assert found.still.n == 4
    assert found.candidates[0][0] == "imu0/acceleration"
    assert found.notes[0] == "a note"
    assert found.mapping == {"acc": ["x"]}


def test_too_short_is_told_with_all_samples_counted() -> None:
    t = np.arange(4) / RATE
    short = Channel(t, np.ones((4, 3)), "m/s2", "acceleration", "imu0", RATE)
    found = inspect_recording([Recording({"imu0/acceleration": short}, "f", "made", "")])
    assert found.still is None
    assert found.channels[0].samples == 4
    assert found.candidates == (("imu0/acceleration", "no rest was found"),)


def test_blocks_and_whole_agree(tmp_path: object) -> None:
    path = f"{tmp_path}/a.h5"
    writers.write(recording(), path)
    one = inspect_recording([readers.read(path)])
    many = inspect_recording(readers.blocks(path, block_samples=100))
    for a, b in zip(one.channels, many.channels, strict=True):
        assert (a.name, a.samples, a.norm_at_rest) == (b.name, b.samples, b.norm_at_rest)
        assert (a.clock.duplicates, a.clock.longest_step) == (
            b.clock.duplicates, b.clock.longest_step,
        )  # fmt: skip
        np.testing.assert_array_equal(a.low, b.low)
    assert one.gaps == many.gaps
