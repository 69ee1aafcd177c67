"""A small input for every command that calibrates, made once a session."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucalib.calibrators.actigraph.simulation import WeekPlan
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.simulation import LogPlan, simulate_log
from imucalib.calibrators.lab.simulation import BenchPlan, simulate_recording, simulate_table
from imucalib.writers import write, write_blocks
from worlds.turned_imu import chip, turned
from worlds.week import simulated_blocks


@dataclass(frozen=True)
class Input:
    """What a command is given: the recording to calibrate and to correct, and its own options."""

    recording: Path
    options: tuple[str, ...]


def _rests(folder: Path) -> Input:
    rng = np.random.default_rng(0)
    table = simulate_table(BenchPlan("rings", 24), rng)
    path = folder / "rests.csv"
    write(simulate_recording(table, rng, rate=50.0, rest=3.0), path)
    return Input(path, ("--reference", "norm"))


def _day(folder: Path) -> Input:
    path = folder / "day.h5"
    write_blocks(simulated_blocks(WeekPlan(days=0.5, rate=10.0), 1), path)
    return Input(path, ())


def _log(folder: Path) -> Input:
    plan = LogPlan(poses=12, pose_seconds=3.0, seconds=20.0, gyro_gain=0.0)
    made = simulate_log(read_board("mimu4444_corners"), plan, np.random.default_rng(0))
    path = folder / "log.h5"
    write(made.recording, path)
    return Input(path, ("--board", "mimu4444_corners", "--samples", "100", "--only", "gyro_delay"))


def _turns(folder: Path) -> Input:
    rng = np.random.default_rng(2)
    made = turned(chip(rng), rng, rests=14)
    return Input(made.write(folder / "turns.csv"), ("--without", "gyro_saturation"))


#: A new calibrating command needs one line here; the laws do the rest.
INPUTS: dict[str, Callable[[Path], Input]] = {
    "lab": _rests,
    "actigraph": _day,
    "array": _log,
    "imu": _turns,
}
