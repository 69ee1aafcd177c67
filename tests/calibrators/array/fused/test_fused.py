"""The fused instrument against a rigid board in plain numpy, whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib.calibrators.array.fused.fuse import Fused, Stretch
from imucalib.calibrators.array.fused.instrument import instrument_of
from imucalib.calibrators.array.fused.recording import Told, fused_stretch
from imucalib.calibrators.array.fused.survey import NotFusable, Survey, side_by_side, survey
from imucalib.errors import UsageError
from imucalib.recording.recording import Recording
from worlds.rigid_board import (
    DEG,
    Board,
    Moves,
    board,
    calibration,
    moves,
    readings,
    recording,
)

Array = NDArray[np.float64]
STILL, HZ = 12.0, 100.0


@dataclass(frozen=True)
class World:
    """A board, what it did, what was read, and what was made of it; moving : (T,)"""

    board: Board
    moves: Moves
    readings: tuple[Array, Array]
    survey: Survey
    fused: Fused

    @property
    def moving(self) -> NDArray[np.bool_]:
        return np.asarray(self.moves.t > STILL + 2.5)

    @property
    def error(self) -> Array:
        """(T, 9) of force at the instrument's point, dω/dt and ω."""
        at, true, found = self.survey.instrument.at, self.moves, self.fused.motion
        force = true.force + np.cross(true.rate, np.cross(true.rate, at[None]))
        force = force + np.cross(true.spin, at[None])
        parts = (found.force - force, found.spin - true.spin, found.rate - true.rate)
        return np.concatenate(parts, axis=1)

    @property
    def z(self) -> Array:
        return np.asarray(self.error / np.sqrt(np.einsum("tii->ti", self.fused.motion.covariance)))


def world(
    seed: int, *, twist: float = 250.0, spoil: Array | None = None, fastest: float = 4.0,
    seconds: float = 25.0, at: Array | None = None, **more: object,
) -> World:  # fmt: skip
    rng = np.random.default_rng(seed)
    made = board(rng, **more)  # type: ignore[arg-type]
    motion = moves(
        rng, still=STILL, moving=seconds, hz=HZ, twist=twist, late=made.late, fastest=fastest
    )
    read = readings(made, motion, rng)
    if spoil is not None:
        read[0][:, spoil] = np.nan
    log = recording(made, motion.t, *read)
    found = survey([log], instrument_of(calibration(made), at))
    stretch = Stretch(motion.t, *read)
    return World(made, motion, read, found, fused_stretch(found, stretch, Told()))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def plain() -> World:
    return world(0)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["still", "moving"])
def test_noise_falls_as_the_root_of_the_chips_and_is_stated(plain: World, part: str) -> None:
    rows = plain.moving if part == "moving" else plain.moves.t < STILL - 0.5
    assert rms(plain.error[rows, 6:]) < 1.05 * 0.2 * DEG / np.sqrt(8)
    assert rms(plain.error[rows, :3]) < 1.05 * 0.04 / np.sqrt(8)
    assert 0.95 < rms(plain.z[rows, :3]) < 1.05
    assert 0.95 < rms(plain.z[rows, 6:]) < 1.05
    # dω/dt leans on how smooth the motion is, which is judged with care.
    assert 0.7 < rms(plain.z[rows, 3:6]) < 1.05


@pytest.mark.slow
def test_missing_stuck_and_clipped_readings_are_left_out() -> None:
    rng = np.random.default_rng(4)
    made = board(rng, ranges=(16.0, 1e9))
    motion = moves(rng, still=STILL, moving=20.0, hz=HZ, twist=250.0)
    acceleration, rate = readings(made, motion, rng)
    rows = slice(2000, 2600)
    rate[rows, 2] = rate[2000, 2]  # it hangs
    acceleration[rows, 5, 1] += 20.0  # one axis goes wild
    acceleration[2100:2300, 0] = np.nan
    clipped = np.abs(acceleration) >= 15.99
    assert clipped.any(axis=(1, 2)).mean() > 0.02
    found = survey(
        [recording(made, motion.t, acceleration, rate)], instrument_of(calibration(made))
    )
    fused = fused_stretch(found, Stretch(motion.t, acceleration, rate), Told())
    at = found.instrument.at
    off = fused.motion.rate - motion.rate
    assert rms(off[2020:2600]) < 1.2 * 0.2 * DEG / np.sqrt(7)
    force = motion.force + np.cross(motion.rate, np.cross(motion.rate, at[None]))
    force = force + np.cross(motion.spin, at[None])
    assert rms((fused.motion.force - force)[rows]) < 1.3 * 0.04 / np.sqrt(6)
    assert not fused.live[2100:2300, 0].any()


@pytest.mark.slow
def test_biases_are_taken_anew_at_rest() -> None:
    made = world(5)
    moved = replace(
        made.board,
        gyro_biases=made.board.gyro_biases + 0.5 * DEG,
        biases=made.board.biases + 0.02 * np.random.default_rng(0).normal(size=(8, 3)),
    )
    rng = np.random.default_rng(6)
    read = readings(moved, made.moves, rng)
    old = instrument_of(calibration(made.board))
    found = survey([recording(moved, made.moves.t, *read)], old)
    assert found.rests > 0.5 * STILL
    fused = fused_stretch(found, Stretch(made.moves.t, *read), Told())
    assert rms(fused.motion.rate - made.moves.rate) < 1.1 * 0.2 * DEG / np.sqrt(8)
    # Without a rest they are the calibration's.
    late = made.moves.t > STILL + 3.0
    cut = recording(moved, made.moves.t[late], read[0][late], read[1][late])
    assert survey([cut], old).rests == 0.0


def _in_blocks(log: Recording, size: int) -> list[Recording]:
    """Every channel cut at its own rows, as readers cut logs of messages."""
    count = max(len(c.t) for c in log.channels.values())
    made = []
    for start in range(0, count, size):
        channels = {}
        for k, (name, c) in enumerate(log.channels.items()):
            rows = slice(max(0, start - 5 * k) if start else 0, start + size - 5 * k)
            last = start + size >= count
            rows = slice(rows.start, None) if last else rows
            channels[name] = replace(c, t=c.t[rows], values=c.values[rows])
        made.append(replace(log, channels=channels))
    return made


@pytest.mark.slow
def test_a_log_in_uneven_blocks_is_the_same(plain: World) -> None:
    log = recording(plain.board, plain.moves.t, *plain.readings)
    parts = list(side_by_side(_in_blocks(log, 777), plain.survey.instrument))
    assert len(parts) > 3
    whole = np.concatenate([p.rate for p in parts])
    assert np.concatenate([p.t for p in parts]) == pytest.approx(plain.moves.t)
    assert np.array_equal(whole, plain.readings[1])
    joined = fused_stretch(plain.survey, Stretch(plain.moves.t[:900], *(
        r[:900] for r in plain.readings
    )), Told())  # fmt: skip
    assert joined.motion.rate[:850] == pytest.approx(plain.fused.motion.rate[:850], abs=1e-6)


def test_what_cannot_be_fused_is_refused(plain: World) -> None:
    log = recording(plain.board, plain.moves.t, *plain.readings)
    one = {n: c for n, c in log.channels.items() if c.triad == "imu0"}
    none = {n: c for n, c in log.channels.items() if c.quantity == "acceleration"}
    raw = {n: replace(c, unit="counts") for n, c in log.channels.items()}
    for channels in (one, none, raw):
        with pytest.raises(NotFusable):
            survey([replace(log, channels=channels)], instrument_of(calibration(plain.board)))
    single = replace(calibration(plain.board), triads=(), calibrator="lab")
    with pytest.raises(UsageError, match="nothing to fuse"):
        instrument_of(single)
