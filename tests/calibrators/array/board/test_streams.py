"""Lost, repeated and late readings are told with their share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.board.log import ArrayLog, array_log
from imucalib.calibrators.array.board.streams import (
    streams,
)
from imucalib.errors import Undetermined
from imucalib.recording.recording import Recording
from imucalib.units import DEG
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")


@pytest.fixture(scope="module")
def recording() -> Recording:
    plan = BoardPlan(twist_s=6.0, rests=9, mounting=0.3, gyro_gain=0.01)
    rng = np.random.default_rng(1)
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, plan, rng)
    return board_log(parts, plan, rng).recording


@pytest.fixture(scope="module")
def log(recording: Recording) -> ArrayLog:
    return array_log(recording, BOARD)


def test_lost_samples_are_told_with_their_share(log: ArrayLog) -> None:
    keep = np.ones(len(log.t), dtype=bool)
    keep[np.random.default_rng(2).choice(len(log.t), len(log.t) // 50, replace=False)] = False
    short = replace(log, t=log.t[keep], acceleration=log.acceleration[keep], rate=log.rate[keep],
                    clipped=log.clipped[keep])  # fmt: skip
    assert streams(short).lost == pytest.approx(0.02, rel=0.1)
    assert next(streams(short).notes).startswith("2 % of the samples are missing")


def test_a_frozen_chip_is_told_and_left_out(log: ArrayLog) -> None:
    rate = log.rate.copy()
    first = len(rate) - 400
    rate[first : first + 60, 3] = rate[first, 3]
    found = streams(replace(log, rate=rate))
    notes = list(found.find_broken(BOARD.imus))
    assert len(notes) == 1
    assert notes[0].startswith("The gyro of imu3 repeats its reading in ")
    assert 0.05 < found.repeated[3, 1] < 0.12
    assert found.held[first + 1 : first + 60].sum() > 45
    assert not found.held[:first].any()
    rate[first - 180 : first + 370, 3] = rate[first, 3]
    with pytest.raises(Undetermined, match="gyro of imu3 repeats its reading"):
        streams(replace(log, rate=rate)).refuse_late(BOARD.imus, log.interval)


@pytest.mark.parametrize("late", [2, -1])
@pytest.mark.parametrize("kind", ["acceleration", "rate"])
def test_a_late_chip_is_told(log: ArrayLog, late: int, kind: str) -> None:
    values = getattr(log, kind).copy()
    values[:, 5] = np.roll(values[:, 5], late, axis=0)
    found = streams(replace(log, **{kind: values}))
    word = "late" if late > 0 else "early"
    sensor = "gyro" if kind == "rate" else "accelerometer"
    with pytest.raises(Undetermined, match=f"{sensor} of imu5 is {word} by {abs(late)}") as caught:
        found.refuse_late(BOARD.imus, log.interval)
    assert caught.value.exit_code == 4
    assert np.count_nonzero(found.shift) == 2
    assert np.isnan(found.since).all()


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_chip_that_loses_a_sample_is_told_with_the_time(log: ArrayLog, share: float) -> None:
    """From there on its readings are those of the next instant, and so are all that it has."""
    moving = np.flatnonzero(np.linalg.norm(np.median(log.rate, axis=1), axis=1) > 0.5)
    lost, parts = moving[int(share * len(moving))], []
    for values in (log.acceleration.copy(), log.rate.copy()):
        values[lost:-1, 5] = values[lost + 1 :, 5]
        parts.append(values)
    found = streams(replace(log, acceleration=parts[0], rate=parts[1]))
    assert np.argwhere(found.shift).tolist() == [[1, 5, 0], [1, 5, 1]]
    assert np.allclose(found.since[5], log.t[lost], atol=0.5)
    with pytest.raises(Undetermined, match=r"gyro of imu5 is early by 1 samples .* from .* s on"):
        found.refuse_late(BOARD.imus, log.interval)


@pytest.mark.parametrize("kind", ["acceleration", "rate"])
def test_a_slow_filter_is_not_told_as_a_late_sample(log: ArrayLog, kind: str) -> None:
    """8 ms at 100 Hz: one sample later it is far more alike the others, and not as they are."""
    values = getattr(log, kind).copy()
    kept = np.exp(-log.interval / 8e-3)
    for before, row in zip(values[:-1, 5], values[1:, 5], strict=True):
        row[:] = kept * before + (1.0 - kept) * row
    assert not streams(replace(log, **{kind: values})).shift.any()


def test_a_range_below_the_stated_one_is_seen(recording: Recording) -> None:
    """A gyro set to half of its range ends there, in whatever sample."""
    end, name = 500.0 * DEG, "imu2/angular_rate"
    gyro = recording.channels[name]
    over = np.any(np.abs(gyro.values) > end, axis=1)
    assert over.sum() > 30
    short = replace(gyro, values=np.clip(gyro.values, -end, end))
    found = array_log(replace(recording, channels={**recording.channels, name: short}), BOARD)
    assert np.array_equal(found.clipped, over)
    (note,) = found.notes
    assert "gyro of imu2 ends at 500 deg/s" in note
    assert "not at its range of 2000" in note


def test_spikes_that_no_other_sensor_knows_of_are_left_out(log: ArrayLog) -> None:
    """Six in 3,659 samples moved positions by 1.5 mm, where the noise was taken for Gaussian."""
    speed = np.linalg.norm(np.median(log.rate, axis=1), axis=1)
    moving, rng = np.flatnonzero((speed > 90.0 * DEG) & ~log.clipped), np.random.default_rng(2)
    force, rate = log.acceleration.copy(), log.rate.copy()
    one, two = rng.choice(moving, 4, replace=False), rng.choice(moving, 3, replace=False)
    force[one, 5, rng.integers(0, 3, 4)] += 60.0
    rate[two, 2, rng.integers(0, 3, 3)] -= 15.0
    found = streams(replace(log, acceleration=force, rate=rate))
    assert np.array_equal(np.flatnonzero(found.held), np.sort(np.concatenate([one, two])))
    assert found.spikes[5].tolist() == [4, 0]
    assert found.spikes[2].tolist() == [0, 3]
    assert found.spikes.sum() == 7
    told = list(found.find_broken(BOARD.imus))
    assert [n.split(" spikes")[0] for n in told] == [
        "The accelerometer of imu5 has 4",
        "The gyro of imu2 has 3",
    ]
