"""Several logs of one board: errors between logs over what they state.

python benchmarks/array/logs.py measured FILE...   logs of the corner board (exp_1, 2, 4, 5)
python benchmarks/array/logs.py simulated [LOGS [--loop]]   any five of a dozen, by numpy alone
"""

from __future__ import annotations

import sys
from itertools import combinations
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
from imucalib.calibrators.array.board.board import read_board
from imucalib.calibrators.array.calibrate import calibrate_array
from imucalib.calibrators.array.logs import PooledLogs, pool_logs
from imucalib.calibrators.array.request import ArrayRequest
from imucalib.readers import read
from worlds.boards import BoardPlan, board_log, made_board

BOARD = read_board("mimu4444_corners")
_FIVE, _TRIED = 5, 60


def report(name: str, found: list[PooledLogs]) -> None:
    left_out = np.concatenate([f.left_out for f in found])
    low, high = np.quantile(left_out, (0.1, 0.9))
    chi2, freedom = (np.median([getattr(f, n) for f in found]) for n in ("chi2", "freedom"))
    small = np.mean([f.p < 0.01 for f in found])
    print(f"| {name} | {np.sqrt(np.mean(left_out**2)):.2f} ({low:.2f} to {high:.2f}) | "
          f"{chi2:.0f} of {freedom:.0f} | {100 * small:.0f} % | "
          f"{1e3 * np.median([f.tau for f in found]):.4f} | "
          f"{1e3 * np.median([np.median(f.between) for f in found]):.4f} | "
          f"{1e3 * np.median([np.sqrt(np.median(np.diag(f.covariance))) for f in found]):.4f} |",
          flush=True)  # fmt: skip


def main() -> None:
    print("| logs | z rms of a log by the others (10, 90 %) | χ² | p < 0.01 | tau, mm | sd between "
          "logs, mm | pooled sd, mm |\n|---|---|---|---|---|---|---|")  # fmt: skip
    if sys.argv[1] == "measured":
        request = ArrayRequest(board=BOARD, gravity=9.8189, gravity_source="as given")
        runs = [calibrate_array(read(Path(f)), request, lambda _: None) for f in sys.argv[2:]]
    else:
        count = int(sys.argv[2]) if len(sys.argv) > 2 else 12
        plan, rng = BoardPlan(mounting=0.3, tails=3.0, gyro_scale=0.003), np.random.default_rng(77)
        parts = made_board(BOARD.positions, BOARD.rotations, BOARD.imus, plan, rng)
        request = ArrayRequest(board=BOARD, loop="--loop" in sys.argv)
        runs = [
            calibrate_array(board_log(parts, plan, rng).recording, request, lambda _: None)
            for _ in range(count)
        ]
    values = np.array([run.total.by_motion[1:].ravel() for run in runs])
    spread = np.array([run.total.motion for run in runs])
    report(f"{len(runs)} together", [pool_logs(values, spread)])
    if len(runs) > _FIVE:
        every = list(combinations(range(len(runs)), _FIVE))
        chosen = np.random.default_rng(0).choice(len(every), _TRIED, replace=False)
        some = [list(every[k]) for k in chosen]
        report(f"any {_FIVE}", [pool_logs(values[at], spread[at]) for at in some])


if __name__ == "__main__":
    main()
