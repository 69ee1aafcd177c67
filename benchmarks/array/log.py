"""A long log of a large array, from MCAP to arrays: python benchmarks/array/log.py.

32 IMUs at 1 kHz as `benchmarks/readers/logs.py` writes them; CPU seconds and peak memory (VmHWM)
of a process that reads the log, and of one that also puts all IMUs side by side as `imucal array`
does.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory


def peak() -> float:
    """VmHWM of this process, MB."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return float(line.split()[1]) / 1024.0
    return float("nan")


def one(stage: str, path: Path) -> None:
    """The measured process."""
    from imucalib.calibrators.array.board.board import read_board
    from imucalib.calibrators.array.board.log import array_log, of_board
    from imucalib.readers import read

    recording = read(path)
    samples = next(iter(recording.channels.values())).t.size
    if stage == "side by side":
        recording, board = of_board(recording, read_board("mimu4444"))
        log = array_log(recording, board)
        assert log.acceleration.shape == (samples, 32, 3)
    print(f"| {stage} | {samples} x 32 | {time.process_time():.1f} | {peak():.0f} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0)
    parser.add_argument("--file", type=Path, help="a log that is there already")
    parser.add_argument("--stage", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.stage:
        one(options.stage, options.file)
        return
    sys.path.insert(0, str(Path(__file__).parents[1] / "readers"))
    from logs import generate

    with TemporaryDirectory() as folder:
        path = options.file or Path(folder) / "array.mcap"
        if options.file is None:
            generate(path, 32, options.seconds)
        print("| stage | samples | CPU s | VmHWM, MB |")
        print("|---|---|---|---|", flush=True)
        for stage in ("read", "side by side"):
            command = [sys.executable, __file__, "--stage", stage, "--file", str(path)]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
