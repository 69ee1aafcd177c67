"""Small arrays with one undeclared error each, as the tests and the benchmark plant them."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.board.board import Board, read_board
from imucalib.calibrators.array.board.log import array_log
from imucalib.calibrators.array.board.moving import Moving, find_moving
from imucalib.calibrators.array.board.rests import RestFit, fit_rests
from imucalib.calibrators.array.motion.closed_loop import MotionLoop, close_array_loop
from imucalib.calibrators.array.motion.laws import array_catalogue
from imucalib.calibrators.array.motion.setup import array_setup
from imucalib.calibrators.array.motion.terms import BoardMotion, board_motion
from imucalib.calibrators.array.simulation import LogPlan, lever_arm, simulate_motion
from imucalib.calibrators.request import Request
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from imucalib.units import DEG

BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(
    poses=14, pose_seconds=3.0, seconds=14.0, twist=800.0, force=20.0, gyro_gain=0.0, gain=0.005
)
#: name of the story -> the effect planted, and the size of each parameter in its unit
STORIES: dict[str, tuple[str, float | Array]] = {
    "clean": ("", 0.0),
    "gyro scale of one IMU, 2 %": ("gyro_scale@imu3", 2.0),
    "gyro scale of each IMU, 2 %": ("gyro_scale", 2.0),
    "common gyro delay, 1 ms": ("gyro_delay", 1.0),
    "clock skew, 1 ms": ("gyro_sample_age", 1.0),
    "quadratic, 0.3 mg/g2": ("quadratic", 0.3),
    "element positions, 0.5 mm": ("sensing_elements", 0.5),
    "bad accelerometer, 1 %": ("scale@imu5", 0.01),
    "bent gyro, 20 deg/s at full scale": ("gyro_quadratic@imu2", 20.0),
    "gyro that feels force, 0.3 deg/s/g": ("gyro_g_sensitivity@imu2", 0.3 * np.eye(3).ravel()),
}


def planted_log(name: str, seed: int, plan: LogPlan = PLAN, board: Board = BOARD) -> tuple[
    Recording, Array
]:  # fmt: skip
    """A bench log with the story's error, and the true positions (K, 3) m."""
    rng = np.random.default_rng(seed)
    effect, size = STORIES[name]
    k = board.count
    true = board.drawn + rng.normal(size=(k, 3)) * plan.scatter
    true -= true[0]
    t, w, _, force = simulate_motion(plan, rng)
    spin = np.gradient(w, t, axis=0)
    felt = lever_arm(w, spin, true) + force[:, None]
    # The triads' mean is the board's frame: a mean error would turn it against the gyros.
    gain = rng.normal(size=(k, 3, 3)) * plan.gain
    gain += np.eye(3) - gain.mean(axis=0)
    jerk = np.gradient(felt, t, axis=0)
    beats = rng.uniform(0.3, 3.0, k) * rng.choice([-1.0, 1.0], k)
    turns = t[:, None] * beats + rng.uniform(size=k)
    motion = board_motion(
        board, t, order=(t - t[0]) / np.ptp(t), rate=w, spin=spin,
        force=felt, jerk=jerk, age=turns - np.floor(turns) - 0.5,
    )  # fmt: skip
    rate = np.repeat(w[:, None], k, axis=1)
    if effect:
        add = planted(effect, size, motion, rng)
        moving = t > plan.poses * plan.pose_seconds
        if effect.startswith("gyro"):
            rate = rate + add
        else:
            # What rests would show is in the calibration by gravity: errors of the motion only.
            felt = felt + add * (moving[:, None, None] if "@" in effect else 1.0)
    channels = {}
    for i, name_ in enumerate(board.imus):
        turn = board.rotations[i].T
        x = felt[:, i] @ (turn @ gain[i]).T + rng.normal(size=3) * plan.bias
        y = rate[:, i] @ turn.T + rng.normal(size=3) * plan.gyro_bias * DEG
        x += rng.normal(size=x.shape) * plan.sigma
        y += rng.normal(size=y.shape) * plan.sigma_gyro * DEG
        x = np.clip(x, -board.accelerometer_range, board.accelerometer_range)
        y = np.clip(y, -board.gyroscope_range, board.gyroscope_range)
        for quantity, unit, values in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
            channels[f"{name_}/{quantity}"] = Channel(t, values, unit, quantity, name_, plan.rate)
    return Recording(channels, "simulated", "simulated", ""), true


def planted(
    effect: str, size: float | Array, motion: BoardMotion, rng: np.random.Generator
) -> Array:
    """(T, K, 3) what the effect adds: one number as given, several at random of that size."""
    name, _, only = effect.partition("@")
    found = array_catalogue()[name]
    basis = motion.turn_to_board(found.basis(motion.truth, motion.context))
    if found.shared:
        theta = np.full(basis.shape[3], size)
        if basis.shape[3] > 1:
            theta = rng.normal(size=basis.shape[3]) * size
        return np.asarray((basis @ theta).swapaxes(0, 1))
    # A mean over all gyros' scales is the array's size, which no motion shows.
    theta = rng.normal(size=(motion.shape[1], basis.shape[3])) * size
    theta -= theta.mean()
    if only:
        theta[:] = 0.0
        theta[motion.context.triads.index(only)] = size
    return np.asarray(np.einsum("ktim,km->tki", basis, theta))


def moving_of(recording: Recording, board: Board = BOARD) -> tuple[Moving, RestFit]:
    segments = still_segments(recording)
    log = array_log(recording, board)
    rests = fit_rests(segments, board, Request())
    return find_moving(log, rests), rests


def closed(recording: Recording, samples: int = 300, board: Board = BOARD) -> MotionLoop:
    from imucalib.calibrators.array.motion.terms import rest_terms

    moving, rests = moving_of(recording, board)
    setup = array_setup(moving, board, samples)
    assert setup is not None
    return close_array_loop(setup, rest_terms(rests), Request(curves=False))


def named(found: MotionLoop) -> set[str]:
    """All effects found, with those that they cannot be told from."""
    return {n for s in found.steps for n in (s.effect, *s.aliases)}


def positions_z(found: MotionLoop, true: Array) -> Array:
    """(3 (K - 1),) errors of the positions in stated deviations, in the triads' mean frame."""
    truth, r = true[1:], found.final.r[1:]
    left, _, right = np.linalg.svd(truth.T @ r)
    n = found.final.positions
    sd = np.sqrt(np.diag(found.final.covariance)[:n])
    return np.asarray((r - truth @ left @ right).ravel() / sd)
