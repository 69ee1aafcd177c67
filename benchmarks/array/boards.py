"""What an array states against the truth of simulated boards: positions as they are, distances, and
the shape whatever the frame is.

python benchmarks/array/boards.py [BOARDS [FIRST_SEED]] [--no-loop] [--keep FILE]

Every board has its own places (0.2 mm), mountings (0.3 deg), gains of accelerometers and gyros
(0.5 %), gravity (1.3e-3, taken for standard) and noise with t₃ tails in motion; numpy alone writes
the logs (`tests/worlds/boards.py`).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.errors import ImucalError
from imucalib.units import STANDARD_GRAVITY
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")


def one(seed: int, *, loop: bool) -> dict[str, np.ndarray]:
    """Errors in stated deviations."""
    rng = np.random.default_rng(seed)
    gravity = STANDARD_GRAVITY * (1.0 + 1.3e-3 * rng.normal())
    plan = BoardPlan(
        twist_s=12.0, mounting=0.3, gain=5e-3, gyro_gain=5e-3, tails=3.0, gravity=gravity
    )
    parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, plan, rng)
    made = board_log(parts, plan, rng)
    run = calibrate_array(made.recording, ArrayRequest(board=BOARD, loop=loop), lambda _: None)
    total, true = run.total, made.positions
    off = (total.mean - true)[1:].ravel()
    pairs = [(a, b) for a in range(BOARD.count) for b in range(a)]
    distances = []
    for a, b in pairs:
        value, sd = total.distance(a, b)
        distances.append((value - np.linalg.norm(true[a] - true[b])) / sd)
    # The truth turned into the frame of the estimate.
    left, _, right = np.linalg.svd(true.T @ total.mean)
    turned = (total.mean - true @ left @ right)[1:].ravel()
    values, vectors = np.linalg.eigh(total.shape)
    seen = values > 1e-6 * values[-1]
    size = total.mean[1:].ravel()
    shape = vectors[:, seen].T @ (turned - size * (size @ turned) / (size @ size))
    whole = np.linalg.solve(np.linalg.cholesky(total.covariance), off)
    return {
        "positions, each": off / np.sqrt(np.diag(total.covariance)),
        "positions, whitened": whole,
        "distances": np.array(distances),
        "shape, whitened": shape / np.sqrt(values[seen]),
    }


def kept(path: Path | None) -> dict[int, dict[str, np.ndarray]]:
    """Boards that are there already, by seed; one that was refused has nothing."""
    if path is None or not path.is_file():
        return {}
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    return {line["seed"]: {n: np.array(z) for n, z in line["z"].items()} for line in lines}


def interval(own: np.ndarray) -> tuple[float, float]:
    """95 % of an rms by resampling whole boards: what one board states shares its fit."""
    rng = np.random.default_rng(0)
    drawn = own[rng.integers(len(own), size=(4000, len(own)))]
    low, high = np.quantile(np.sqrt(np.mean(drawn**2, axis=1)), (0.025, 0.975))
    return float(low), float(high)


def printed(done: dict[int, dict[str, np.ndarray]]) -> None:
    """The table of all boards."""
    whole = [z for z in done.values() if z]
    print("| errors over stated sd | rms | 95 % | each board's rms: 10 %, 90 % |")
    print("|---|---|---|---|")
    for name in whole[0]:
        own = np.array([np.sqrt(np.mean(z[name] ** 2)) for z in whole])
        low, high = interval(own)
        few, many = np.quantile(own, (0.1, 0.9))
        rms = np.sqrt(np.mean(own**2))
        print(f"| {name} | {rms:.2f} | {low:.2f} to {high:.2f} | {few:.2f}, {many:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("boards", type=int, nargs="?", default=200)
    parser.add_argument("first", type=int, nargs="?", default=6000, help="the first seed")
    parser.add_argument("--no-loop", action="store_true")
    parser.add_argument("--keep", type=Path, help="JSON lines, one a board: a stopped run goes on")
    options = parser.parse_args()
    seeds = range(options.first, options.first + options.boards)
    done = {seed: z for seed, z in kept(options.keep).items() if seed in seeds}
    start, fresh = time.process_time(), 0
    for seed in seeds:
        if seed in done:
            continue
        try:
            z = one(seed, loop=not options.no_loop)
        except ImucalError as error:
            print(f"<!-- {seed}: {error} -->", file=sys.stderr)
            z = {}
        done[seed], fresh = z, fresh + 1
        if options.keep is not None:
            with options.keep.open("a") as out:
                line = {"seed": seed, "z": {n: v.tolist() for n, v in z.items()}}
                out.write(json.dumps(line) + "\n")
    cost = f", {(time.process_time() - start) / fresh:.1f} CPU s each of {fresh}" if fresh else ""
    refused = sum(not z for z in done.values())
    print(f"{len(done)} boards, seeds from {options.first}, {refused} refused{cost}\n")
    printed(done)


if __name__ == "__main__":
    main()
