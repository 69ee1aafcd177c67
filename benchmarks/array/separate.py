"""Whether the motion that `design --separate` advises ends an ambiguity of an array.

    python benchmarks/array/separate.py [--boards 5] [--truth bias_drift ...]

A board of eight IMUs is made by plain numpy: fourteen rests, then twelve seconds turned about one
axis. Where a name has rivals the advised motion is appended, of the same board and truth, and all
is searched again. `right` is one name and the true one, without rivals; beside it twice as long of
a motion at random. How long the others need is told by the plan.
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from dataclasses import dataclass

import numpy as np

from imucalib.calibrators.array.board import read_board
from imucalib.calibrators.array.log import array_log, of_board
from imucalib.calibrators.array.loop.closed_loop import MotionLoop, close_array_loop
from imucalib.calibrators.array.loop.setup import array_setup
from imucalib.calibrators.array.loop.terms import rest_terms
from imucalib.calibrators.array.moving import moving_part
from imucalib.calibrators.array.rests import fit_rests
from imucalib.calibrators.array.separate.menu import menu
from imucalib.calibrators.array.separate.motion_plan import motion_plans
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import still_segments

G, DEG, HZ = 9.80665, np.pi / 180.0, 100.0
BOARD = read_board("mimu4444_corners")
SIGMA, SIGMA_GYRO = 0.04, 0.2 * DEG
#: What is planted, of one size on every IMU up to its sign.
SIZES = {"bias_drift": 0.014, "asymmetry": 0.0011, "gyro_delay": 3e-4, "quadratic": 1.1e-4}


@dataclass(frozen=True)
class Piece:
    """t (s), rate (rad/s), force of the first IMU (m/s²), each (T, ...)"""

    t: np.ndarray
    rate: np.ndarray
    force: np.ndarray


def rests(rng: np.random.Generator) -> Piece:
    t = np.arange(round(14 * 3.0 * HZ)) / HZ
    way = rng.standard_normal((14, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    return Piece(t, np.zeros((len(t), 3)), G * way[np.minimum((t / 3.0).astype(int), 13)])


def one_axis(rng: np.random.Generator, seconds: float = 12.0) -> Piece:
    """To and fro about one axis, mostly."""
    t = np.arange(round(seconds * HZ)) / HZ
    axis = np.array([0.15, 0.1, 1.0]) / np.linalg.norm([0.15, 0.1, 1.0])
    tones, phases = rng.uniform(0.5, 2.5, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    wave = np.sin(2.0 * np.pi * tones * t[:, None] + phases).sum(axis=1)
    wobble = np.sin(2.0 * np.pi * rng.uniform(0.5, 2.0, 3) * t[:, None] + rng.uniform(0, 6, 3))
    rate = 350.0 * DEG * wave[:, None] * axis + 80.0 * DEG * wobble
    force = G * np.array([0.0, 0.2, 0.98]) + 3.0 * np.sin(4.1 * t)[:, None] * np.ones(3)
    return Piece(t, rate, force)


def joined(pieces: list[Piece]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One after the other, each fading in and out within half a second."""
    t, rate, force, start = [], [], [], 0.0
    for k, piece in enumerate(pieces):
        fade = np.ones(len(piece.t)) if k == 0 else np.clip(
            np.minimum(piece.t, piece.t[-1] - piece.t) / 0.5, 0.0, 1.0)  # fmt: skip
        still = G * np.array([0.0, 0.0, 1.0])
        t.append(start + piece.t)
        rate.append(piece.rate * fade[:, None])
        force.append(piece.force * fade[:, None] + still * (1.0 - fade)[:, None])
        start += piece.t[-1] + 1.0 / HZ
    return np.concatenate(t), np.concatenate(rate), np.concatenate(force)


def recording(truth: str, pieces: list[Piece], seed: int) -> Recording:
    """All IMUs in their own axes, with the truth planted. The same seed is the same board."""
    rng = np.random.default_rng(seed)
    r = BOARD.positions + 2e-4 * rng.standard_normal(BOARD.positions.shape)
    signs = rng.choice([-1.0, 1.0], (BOARD.count, 3)) * rng.uniform(0.7, 1.3, (BOARD.count, 3))
    gain = 0.005 * rng.standard_normal((BOARD.count, 3, 3))
    gain += np.eye(3) - gain.mean(axis=0)
    bias = 0.3 * rng.standard_normal((BOARD.count, 3))
    gyro_bias = 2.0 * DEG * rng.standard_normal((BOARD.count, 3))
    t, w, s = joined(pieces)
    spin = np.gradient(w, t, axis=0)
    begin = pieces[0].t[-1]
    order = np.clip((t - begin) / 12.0, 0.0, None)  # what drifts goes on after the first motion
    moving = (t > begin)[:, None]
    channels = {}
    for k, name in enumerate(BOARD.imus):
        arm = r[k] - r[0]
        felt = s + np.cross(spin, arm) + np.cross(w, np.cross(w, arm))
        own, rate = felt @ BOARD.rotations[k], w @ BOARD.rotations[k]
        size = SIZES[truth] * signs[k]
        if truth == "bias_drift":
            own = own + moving * (order - 0.5)[:, None] * size
        elif truth == "asymmetry":
            own = own + moving * np.abs(own) * size
        elif truth == "quadratic":
            own = own + moving * own**2 * size
        else:
            rate = rate - SIZES[truth] * spin @ BOARD.rotations[k]
        x = own @ gain[k].T + bias[k] + SIGMA * rng.standard_normal(own.shape)
        y = rate + gyro_bias[k] + SIGMA_GYRO * rng.standard_normal(rate.shape)
        for quantity, unit, v in (("acceleration", "m/s2", x), ("angular_rate", "rad/s", y)):
            channels[f"{name}/{quantity}"] = Channel(t, v, unit, quantity, name, HZ)
    return Recording(channels, "simulated", "simulated", "")


def search(log: Recording) -> MotionLoop:
    log, board = of_board(log, BOARD)
    segments = still_segments(log)
    laid = array_log(log, board)
    order = [segments.triads.index(name) for name in board.imus]
    fitted = fit_rests(segments, board, order, G)
    moving = moving_part(laid, fitted)
    setup = array_setup(moving, board, 300, robust=True)
    assert setup is not None
    return close_array_loop(setup, rest_terms(fitted), moving)


def right(loop: MotionLoop, truth: str) -> bool:
    steps = loop.named
    return len(steps) == 1 and steps[0].effect == truth and not steps[0].aliases


def trial(truth: str, seed: int) -> dict | None:
    rng = np.random.default_rng((seed, 7))
    before = [rests(rng), one_axis(rng)]
    loop = search(recording(truth, before, seed))
    if os.environ.get("SHOW"):
        print([(s.effect, s.aliases, round(s.evidence)) for s in loop.steps], flush=True)
    found = [p for p in motion_plans(loop, np.random.default_rng(seed))
             if truth in p.separation.rivals]  # fmt: skip
    if not found or found[0].motion is None:
        return None
    plan = found[0]
    if os.environ.get("SHOW"):
        print(plan.motion.words, plan.seconds, plan.separation, flush=True)

    def after(motion, seconds: float) -> bool:
        t = np.arange(round(seconds * HZ)) / HZ
        made = motion.at(t)
        return right(
            search(recording(truth, [*before, Piece(t, made.rate, made.force)], seed)), truth
        )

    every = menu(35.0)
    other = every[int(rng.integers(len(every)))]
    return {
        "plan": plan, "right": after(plan.motion, plan.seconds),
        "random 2": after(other, 2.0 * plan.seconds),
    }  # fmt: skip


def main() -> None:
    """One line a truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--boards", type=int, default=5)
    parser.add_argument("--truth", nargs="+", default=list(SIZES))
    asked = parser.parse_args()
    for truth in asked.truth:
        every = [trial(truth, seed) for seed in range(asked.boards)]
        told = [o for o in every if o is not None]
        if not told:
            print(f"{truth}: none of {asked.boards} is ambiguous", flush=True)
            continue
        print(row(truth, asked.boards, told), flush=True)


def row(truth: str, boards: int, told: list[dict]) -> str:
    """A line of the table: medians; seconds that other motions need for the same."""
    plans = [o["plan"] for o in told]
    made = [p.separation for p in plans]
    ways = sorted({" ".join(p.motion.words) for p in plans})
    now, then = (np.median([getattr(one, k).min() for one in made]) for k in ("now", "apart"))
    other = [
        np.median([5.0 * (one.needed or one.followed + 1) for one in every if one is not None])
        for every in ([m.informative for m in made], [m.random for m in made])
    ]
    cells = [truth, f"{len(told)} of {boards}", f"{np.median([p.seconds for p in plans]):.0f}",
             f"{now:.1f} -> {then:.1f}", str(sum(o["right"] for o in told)),
             *(f"{v:.0f}" for v in other), str(sum(o["random 2"] for o in told)),
             "; ".join(ways)]  # fmt: skip
    return "| " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
