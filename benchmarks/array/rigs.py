"""Rigs of two IMUs and more: errors over stated deviations, and what is refused.

python benchmarks/array/rigs.py [SEEDS [RIG]]; noise with t₃ tails, 0.04 m/s² and 0.2 deg/s, without
the search. What the motion alone says: distances, and the shape but for a turn of the board. Where
a rig's name ends in "gyros 0.5 %", its gyros have gains of that size, their common scale apart.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from imucalib.calibrators.array.board.board import Board, read_board, undrawn_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.motion.total import Total
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.errors import ImucalError
from worlds.boards import BoardPlan, board_log, made_board

CORNERS = read_board("mimu4444_corners")
PLACES = {
    "pair, 20 mm": [(0, 0, 0), (20, 0, 0)],
    "pair, 2 mm": [(0, 0, 0), (0, 0, 2)],
    "three on a line": [(0, 0, 0), (10, 0, 0), (20, 0, 0)],
    "three": [(0, 0, 0), (20, 0, 0), (0, 20, 0)],
    "flat four": [(0, 0, 0), (20, 0, 0), (0, 20, 0), (20, 20, 0)],
}
GYROS = ", gyros 0.5 %"


def rig(name: str) -> Board:
    """A board of that name; all packages in one attitude but for the eight corners."""
    if name.startswith("eight"):
        return CORNERS
    places = 1e-3 * np.array(PLACES[name.removesuffix(GYROS)], float)
    k = len(places)
    names = tuple(f"imu{i}" for i in range(k))
    return Board(name, names, places, np.tile(np.eye(3), (k, 1, 1)))


def one(name: str, seed: int) -> tuple[np.ndarray, np.ndarray, float]:
    """z of the distances and of the shape (whitened, turned), and the median sd in mm."""
    board, rng = rig(name), np.random.default_rng(seed)
    apart = 0.005 if name.endswith(GYROS) else 0.0
    plan = BoardPlan(twist_s=15.0, mounting=0.2, gain=0.0, tails=3.0, gyro_gain=apart)
    parts = made_board(board.positions, board.rotations, board.imus, plan, rng)
    common = np.einsum("kij,kij->", parts.gyro_gain, parts.gain) / (3.0 * board.count)
    parts = replace(parts, gyro_gain=parts.gyro_gain / common)
    asked = undrawn_board(board.count) if name.endswith("no drawing") else board
    recording = board_log(parts, plan, rng).recording
    run = calibrate_array(recording, ArrayRequest(board=asked, loop=False), lambda _: None)
    true = parts.positions
    # Gravity and the gyros' common scale are right here: what the motion alone says is tested.
    found = Total(run.total.by_motion, np.zeros_like(run.total.joint), run.total.by_motion,
                  run.total.motion)  # fmt: skip
    d = len(found.motion)
    found.joint[:d, :d] = found.motion
    distances = []
    for a in range(board.count):
        for b in range(a):
            value, sd = found.distance(a, b)
            distances.append((value - np.linalg.norm(true[a] - true[b])) / sd)
    left, _, right = np.linalg.svd(true.T @ found.mean)
    off = (found.mean - true @ left @ right)[1:].ravel()
    size = found.mean[1:].ravel()
    off = off - size * (size @ off) / (size @ size)
    values, vectors = np.linalg.eigh(found.shape)
    seen = values > 1e-9 * np.diag(found.motion).max()
    shape = vectors[:, seen].T @ off / np.sqrt(values[seen])
    return np.array(distances), shape, 1e3 * float(np.median(np.sqrt(np.diag(found.motion))))


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    names = sys.argv[2:] or [*PLACES, "eight", "eight, no drawing"]
    print("| rig | refused | z distances | z shape | sd of the motion, mm | CPU s |")
    print("|---|---|---|---|---|---|")
    for name in names:
        found, refused, start = [], 0, time.process_time()
        for seed in range(8000, 8000 + seeds):
            try:
                found.append(one(name, seed))
            except ImucalError as error:
                refused += 1
                print(f"<!-- {name}, {seed}: {error} -->", file=sys.stderr)
        if not found:
            print(f"| {name} | {refused} of {seeds} | | | | |")
            continue
        far, shape = (np.concatenate([f[i] for f in found]) for i in range(2))
        z = [f"{np.sqrt(np.mean(v**2)):.2f}" if v.size else "-" for v in (far, shape)]
        sd = np.median([f[2] for f in found])
        cpu = (time.process_time() - start) / seeds
        print(f"| {name} | {refused} of {seeds} | {z[0]} | {z[1]} | {sd:.4f} | {cpu:.1f} |",
              flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
