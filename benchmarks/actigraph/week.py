"""Time and memory of `imucal actigraph` on generated weeks: python benchmarks/actigraph/week.py.

Writes an HDF5 recording of some days, then measures the whole command in a process of its own:
CPU seconds, wall seconds and peak memory, beside that of the interpreter with its imports.
"""

from __future__ import annotations

import argparse
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np

from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks


def make(path: Path, days: float, rate: float) -> None:
    """A contiguous float32 recording in g."""
    with h5py.File(path, "w") as file:
        n = round(days * 86400 * rate)
        data = file.create_dataset("accelerometer/data", (n, 3), "f4")
        data.attrs["unit"] = "g"
        data.attrs["sample_rate"] = rate
        at = 0
        for block in worn_blocks(WeekPlan(days=days, rate=rate, temperature=False), 1):
            values = block.channels["imu0/acceleration"].values / 9.80665
            data[at : at + len(values)] = values
            at += len(values)


def environment() -> dict[str, str]:
    """One BLAS thread, and bytecode kept between runs as in an installed package."""
    cache = str(Path(tempfile.gettempdir()) / "imucal_benchmark_bytecode")
    kept = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
    own = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": cache}
    return {**kept, **own}


#: Not the peak of getrusage, which starts with that of the parent.
_PEAK = "int(open('/proc/self/status').read().split('VmHWM:')[1].split()[0]) / 1024"


def peak() -> float:
    """Peak memory of this process, MB; Linux only."""
    return int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0]) / 1024


def measured(arguments: list[str]) -> tuple[float, float, float, int]:
    """CPU s, wall s, peak MB and exit code of a command of imucal."""
    code = (
        "import resource, sys; from imucalib.cli import cli\n"
        "try: code = cli.main(sys.argv[1:], standalone_mode=False)\n"
        "finally:\n"
        "    use = resource.getrusage(resource.RUSAGE_SELF)\n"
        f"    high = {_PEAK}\n"
        "    print('USE', use.ru_utime + use.ru_stime, high, file=sys.stderr)\n"
        "sys.exit(code)"
    )
    start = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, env=environment(),
        check=False,
    )  # fmt: skip
    wall = time.perf_counter() - start
    use = next(x for x in done.stderr.splitlines() if x.startswith("USE")).split()
    return float(use[1]), wall, float(use[2]), done.returncode


def main() -> None:
    """Print one line a recording."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", default="1,7", help="lengths in days")
    parser.add_argument("--rate", type=float, default=100.0)
    options = parser.parse_args()
    resource.getrusage(resource.RUSAGE_SELF)
    print(f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}")
    with tempfile.TemporaryDirectory() as folder:  # once, for the bytecode
        path = Path(folder) / "day.h5"
        make(path, 0.5, 50.0)
        measured(["actigraph", str(path), "-o", str(Path(folder) / "out"), "-q"])
    cpu, wall, peak, _ = measured(["--version"])
    print(f"imucal --version: {cpu:.2f} CPU s, {wall:.2f} wall s, {peak:.0f} MB")
    for days in (float(d) for d in options.days.split(",")):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "week.h5"
            make(path, days, options.rate)
            command = ["actigraph", str(path), "-o", str(Path(folder) / "out"), "-q"]
            cpu, wall, peak, code = measured(command)
        print(
            f"{days:g} d at {options.rate:g} Hz, HDF5: {cpu:.2f} CPU s, {wall:.2f} wall s, "
            f"{peak:.0f} MB, exit {code}"
        )


if __name__ == "__main__":
    main()
