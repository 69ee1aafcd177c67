"""What an array states against the truth of simulated boards: positions as they are, distances, and
the shape whatever the frame is.

python benchmarks/array/boards.py [BOARDS [FIRST_SEED [--no-loop]]]

Every board has its own places (0.2 mm), mountings (0.3 deg), gains of accelerometers and gyros
(0.5 %), gravity (1.3e-3, taken for standard) and noise with t₃ tails in motion; numpy alone writes
the logs (`tests/worlds/boards.py`).
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from imucalib.calibrators.array.board import read_board
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
    run = calibrate_array(made.recording, ArrayRequest(BOARD, loop=loop), lambda _: None)
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


def main() -> None:
    boards = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 5000
    found: dict[str, list[np.ndarray]] = {}
    refused, start = 0, time.process_time()
    for seed in range(first, first + boards):
        try:
            for name, z in one(seed, loop="--no-loop" not in sys.argv).items():
                found.setdefault(name, []).append(z)
        except ImucalError as error:
            refused += 1
            print(f"<!-- {seed}: {error} -->", file=sys.stderr)
    print(f"{boards} boards, seeds from {first}, {refused} refused, "
          f"{(time.process_time() - start) / boards:.1f} CPU s each\n")  # fmt: skip
    print("| errors over stated sd | rms | each board's rms: 10 %, 90 % |\n|---|---|---|")
    for name, z in found.items():
        own = np.array([np.sqrt(np.mean(v**2)) for v in z])
        rms = np.sqrt(np.mean(np.concatenate(z) ** 2))
        low, high = np.quantile(own, (0.1, 0.9))
        print(f"| {name} | {rms:.2f} | {low:.2f}, {high:.2f} |")


if __name__ == "__main__":
    main()
