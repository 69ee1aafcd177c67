"""Run the main jobs on the sample logs and say where the reports are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent


def main(command: str, folder: str) -> int:
    """Run each job; a job's exit code must be the one that its data deserve."""
    out = Path(folder)
    bench, rests = str(HERE / "bench.csv"), str(HERE / "rests.mcap")
    calibration = str(out / "rests" / "calibration.yaml")
    jobs = [
        (
            "A bench table with a wrong record: found, and left to the user (exit 5)",
            5,
            ["lab", bench, "-o", str(out / "bench_as_recorded")],
        ),
        (
            "The same with the record repaired: the bench's dial error is found (exit 0)",
            0,
            ["lab", bench, "--fix", "10:y=-45.86119676", "-o", str(out / "bench")],
        ),
        (
            "A recording at rest in 24 positions: the sensor's squares are found (exit 0)",
            0,
            ["lab", str(HERE / "positions.csv"), "--recording", rests, "-o", str(out / "rests")],
        ),
        (
            "The recording corrected, as MCAP",
            0,
            ["apply", calibration, rests, "-o", str(out / "corrected.mcap"), "--force"],
        ),
    ]
    for title, expected, arguments in jobs:
        print(f"\n== {title}\n$ imucal {' '.join(arguments)}\n", flush=True)
        code = subprocess.run([command, *arguments], check=False).returncode
        if code != expected:
            print(f"demo failed: exit code {code} instead of {expected}", file=sys.stderr)
            return 1
    print("\nReports:")
    for page in sorted(out.glob("*/report.html")):
        print(f"  {page.resolve()}")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
