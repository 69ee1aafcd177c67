"""Array logs for the acceptance benchmark: eight IMUs, 200 moving samples, 0.04 m/s², 0.2 deg/s.

Effects act in the motion. Directions of their parameters that no motion shows (the mean gyro scale
is the array's size) are not planted: base, final and oracle would share their error.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray
from trial import Job, Trial, noise, said

from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.board.log import array_log, of_board
from imucalib.calibrators.array.board.moving import find_moving
from imucalib.calibrators.array.board.rests import fit_rests
from imucalib.calibrators.array.motion.closed_loop import MotionLoop, close_array_loop
from imucalib.calibrators.array.motion.laws import array_catalogue
from imucalib.calibrators.array.motion.search import add_declared, new_term, own_gram
from imucalib.calibrators.array.motion.setup import Setup, array_setup
from imucalib.calibrators.array.motion.state import ArrayState, start_state
from imucalib.calibrators.array.motion.terms import Term, board_motion, rest_terms, typical_of
from imucalib.calibrators.array.simulation import LogPlan, lever_arm, simulate_motion
from imucalib.calibrators.request import Request
from imucalib.errors import Undetermined
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments
from imucalib.units import DEG, STANDARD_GRAVITY

Array = NDArray[np.float64]

SAMPLES = 200
BOARD = read_board("mimu4444_corners")
PLAN = LogPlan(
    poses=14, pose_seconds=3.0, seconds=14.0, twist=800.0, force=20.0, gyro_gain=0.0, gain=0.005
)
LAMBDAS = (4.0, 8.0, 25.0)  # expected lengths of what is planted, in units of the noise
OUTSIDE = {
    "gyro_rectification": "|a|",
    "soft_saturation": "|a|",
    "imu_shifts": f"time {' '.join(BOARD.imus)}",
}
NOISE = ("t4", "ar", "slow clock")
FAULTS: tuple[str, ...] = ()
CONFOUNDED: tuple[tuple[str, str, float], ...] = (
    ("bias_drift", "", 1.0),
    ("warm_up", "", 0.8),
    ("asymmetry", "", 0.2),
)
#: What no motion shows: always listed, with what it would do to the positions.
ABSORBED = ("common_gyro_scale", "common_accelerometer_scale", "common_accelerometer_bias")


def effects() -> tuple[str, ...]:
    """Effects that this motion carries and positions do not absorb."""
    context = _Log(Job("array", "reference", 0), np.random.default_rng(0)).motion.context
    shown = {n for n, e in array_catalogue().items() if not e.missing(context)}
    return tuple(name for name in array_catalogue() if name in shown.difference(ABSORBED))


def sizes(name: str) -> tuple[float, ...]:
    """Sizes of a single effect, in typical ones: about as long as the noise allows to be found,
    and the typical size itself."""
    if "sample_age" in array_catalogue()[name].needs:
        return (0.35, 1.0, 3.0)  # a beat line has to stand out first
    expected = float(np.sqrt(np.trace(own_gram(_reference(name), array_catalogue()[name]))))
    return (*(round(value / expected, 4) for value in LAMBDAS), 1.0)


def trial(job: Job) -> Trial:
    """Simulate a log, close the loop on it, and judge."""
    log = _Log(job, np.random.default_rng(job.seed))
    setup, terms = _ready(log.recording)
    started = time.process_time()
    loop = close_array_loop(setup, terms, Request(curves=job.outside is not None))
    seconds = time.process_time() - started
    strength: tuple[float, ...] = ()
    oracle = loop.base
    try:
        oracle = add_declared(loop.base, tuple(log.planted))
        strength = tuple(_strength(oracle, name, theta) for name, theta in log.planted.items())
    except Undetermined:  # the motion shows nothing of what was planted
        pass
    covered, intervals = _coverage(loop, log.positions)
    found = Trial(
        job,
        strength=strength,
        before=_error(loop.base, log.positions),
        after=_error(loop.final, log.positions),
        oracle=_error(oracle, log.positions),
        covered=covered,
        intervals=intervals,
        seconds=seconds,
    )
    listed = tuple(name for name, metres in loop.impact.items() if np.isfinite(metres))
    return replace(said(found, loop), absorbed=listed)


class _Log:
    """A bench log with all that was planted in it; positions : (K, 3) m, the truth."""

    def __init__(self, job: Job, rng: np.random.Generator) -> None:
        self.job, k = job, BOARD.count
        true = BOARD.drawn + rng.normal(size=(k, 3)) * PLAN.scatter
        self.positions = true - true[0]
        t, w, _, force = simulate_motion(PLAN, rng)
        spin = np.gradient(w, t, axis=0)
        self.turning = w, spin
        felt = lever_arm(w, spin, self.positions) + force[:, None]
        begin = PLAN.poses * PLAN.pose_seconds
        self.moving, order = t > begin, np.clip((t - begin) / PLAN.seconds, 0.0, 1.0)
        jerk = np.gradient(felt, t, axis=0)
        beats = rng.uniform(0.3, 3.0, k) * rng.choice([-1.0, 1.0], k)
        turns = t[:, None] * beats + rng.uniform(size=k)
        self.motion = board_motion(
            BOARD, t, order=order, rate=w, spin=spin,
            force=felt, jerk=jerk, age=turns - np.floor(turns) - 0.5,
        )  # fmt: skip
        self.planted = {name: _drawn(name, size, rng) for name, size in job.effects}
        rate = np.repeat(w[:, None], k, axis=1)
        for name, theta in self.planted.items():
            effect = array_catalogue()[name]
            if effect.lagged is not None and "age" not in " ".join(effect.needs):
                one = rate if effect.channel == "angular_rate" else felt
                late = _late(t, one, 1e-3 * theta, name) - one
                one += late * self.moving[:, None, None]
                continue
            term = Term(name, effect, None, np.eye(len(theta)), theta, np.ones(len(theta)))
            add = term.reading(self.motion) * self.moving[:, None, None]
            if effect.channel == "angular_rate":
                rate += add
            else:
                felt = felt + add
        felt, rate = self._outside(felt, rate, rng)
        self.recording = self._recording(felt, rate, rng)

    def _outside(self, felt: Array, rate: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Readings with what no catalogue effect does."""
        name, size = self.job.outside or (self.job.noise, 1.0)
        own, turn = self.motion.truth, BOARD.rotations
        order, one = self.motion.context["order"], int(rng.integers(1, BOARD.count))
        signs = np.sin(rng.uniform(0.0, 2.0 * np.pi, 3))
        at = rng.uniform(0.3, 0.7)
        if name == "gyro_rectification":
            square = np.sum(own.force**2, axis=2, keepdims=True) / STANDARD_GRAVITY**2
            rate = rate + square * (6e-3 * DEG * size * (turn @ signs))
        elif name == "soft_saturation":
            steep = np.sign(own.force) * np.maximum(np.abs(own.force) - 35.0, 0.0) ** 2
            felt = felt - 5e-4 * size * np.einsum("kij,tkj->tki", turn, steep)
        elif name == "imu_shifts":
            shift = np.zeros((BOARD.count, 3))
            shift[one] = 1e-4 * size * signs
            felt = felt + lever_arm(*self.turning, shift) * (order > at)[:, None, None]
            self.positions = self.positions + shift * (1.0 - at)  # the mean over the motion
        elif name == "slow clock":
            rate[:, one] -= 5e-5 * (order - 0.5)[:, None] * self.turning[1]
        return felt, rate

    def _recording(self, felt: Array, rate: Array, rng: np.random.Generator) -> Recording:
        """The log as a recorder saves it, each chip in its own axes."""
        k, t = BOARD.count, self.motion.context["time"]
        # The triads' mean is the board's frame: a mean error would turn it against the gyros.
        gain = rng.normal(size=(k, 3, 3)) * PLAN.gain
        gain += np.eye(3) - gain.mean(axis=0)
        channels = {}
        for i, name in enumerate(BOARD.imus):
            turn = BOARD.rotations[i].T
            x = felt[:, i] @ (turn @ gain[i]).T + rng.normal(size=3) * PLAN.bias
            y = rate[:, i] @ turn.T + rng.normal(size=3) * PLAN.gyro_bias * DEG
            x += self._noise(rng) * PLAN.sigma
            y += self._noise(rng) * PLAN.sigma_gyro * DEG
            x = np.clip(x, -BOARD.accelerometer_range, BOARD.accelerometer_range)
            y = np.clip(y, -BOARD.gyroscope_range, BOARD.gyroscope_range)
            for quantity, unit, v in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
                channels[f"{name}/{quantity}"] = Channel(t, v, unit, quantity, name, PLAN.rate)
        return Recording(channels, "simulated", "simulated", "")

    def _noise(self, rng: np.random.Generator) -> Array:
        """(N, 3) of unit variance; another kind than Gaussian comes with the motion."""
        shape = (len(self.moving), 3)
        plain, odd = noise("", shape, rng), noise(self.job.noise, shape, rng)
        return np.where(self.moving[:, None], odd, plain)


def _ready(recording: Recording) -> tuple[Setup, tuple[Term, ...]]:
    """All that the command does before the loop."""
    recording, board = of_board(recording, BOARD)
    segments = still_segments(recording)
    log = array_log(recording, board)
    rests = fit_rests(segments, board, Request())
    setup = array_setup(find_moving(log, rests), board, SAMPLES)
    assert setup is not None
    return setup, rest_terms(rests)


@cache
def _reference(name: str) -> ArrayState:
    """A log that lacks nothing, but shows the chips' clocks to an effect that needs them."""
    aged = "sample_age" in array_catalogue()[name].needs
    log = _Log(Job("array", "reference", 0), np.random.default_rng(0))
    setup, terms = _ready(log.recording)
    state = start_state(setup, terms)
    age = log.motion.age
    assert age is not None
    rows = np.searchsorted(log.motion.context["time"], setup.t)
    return replace(state, motion=state.motion.set_ages(age[rows])) if aged else state


@cache
def _shown(name: str) -> Array:
    """(p, q) the directions of an effect's typical sizes that the data can determine."""
    term = new_term(_reference(name), name, array_catalogue()[name])
    return term.live / typical_of(term.effect, len(term.live))[:, None]


def _late(t: Array, values: Array, tau: Array, name: str) -> Array:
    """(n, K, 3) what sensors read of values (n, K, 3) that are late, or behind a low-pass of the
    first order, by tau (1,) or (K,) s: x(t - τ), and y + τ dy/dt = x to the third order."""
    from scipy.interpolate import make_interp_spline

    course = make_interp_spline(t, values, k=5)
    each = np.broadcast_to(tau, values.shape[1])
    if "low_pass" in name:
        return np.asarray(sum((-each[:, None]) ** k * course(t, k) for k in range(4)))
    return np.stack([course(t - one)[:, k] for k, one in enumerate(each)], axis=1)


def _drawn(name: str, size: float, rng: np.random.Generator) -> Array:
    """(p,) parameters of about that size, of random sign."""
    shown = _shown(name)
    many = rng.standard_normal(len(shown))
    z = shown @ (shown.T @ many) if len(shown) > 1 else np.sign(many)
    z = np.abs(z) if "low_pass" in name else z  # no filter has a negative time
    return np.asarray(size * typical_of(array_catalogue()[name], len(shown)) * z)


def _strength(oracle: ArrayState, name: str, theta: Array) -> float:
    """λ of a planted effect: its columns times its true size, beside all else that is fitted, in
    units of the noise."""
    rest = replace(oracle, terms=tuple(t for t in oracle.terms if t.name != name))
    effect = array_catalogue()[name]
    z = theta / typical_of(effect, len(theta))
    return float(np.sqrt(z @ own_gram(rest, effect) @ z))


def _error(state: ArrayState, positions: Array) -> float:
    """mm rms of a coordinate, in the frame that the triads share."""
    return float(1e3 * np.sqrt(np.mean((state.r - positions)[1:] ** 2)))


def _coverage(loop: MotionLoop, positions: Array) -> tuple[int, int]:
    """95 % intervals of the coordinates that hold the truth, of how many."""
    n = loop.final.positions
    sd = np.sqrt(np.diag(loop.final.covariance)[:n] * loop.dispersion)
    inside = np.abs((loop.final.r - positions)[1:].ravel()) <= 1.96 * sd
    return int(inside.sum()), n
