"""What commands cost beside what they cannot do without: python benchmarks/cost.py [--write].

Each command is a child of this process, which is small and imports nothing large: the peak memory
of a child begins with that of its parent. What it is held against (SHA-256 and one pass over the
same file, the same command without its search, one recording alone) is measured in the same run,
before it. Prints a table; --write puts it into RESULTS.md in the place of the last one. --skdh is a
Python that has scikit-digital-health, which is measured on the plain week: it needs 6 GB there.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

#: What is planted in a week, by its name.
WEEKS = {
    "plain": {},
    "one effect": {"temperature_bias": (0.6, -0.5, 0.4)},
    "two effects": {"temperature_bias": (0.6, -0.5, 0.4), "quadratic": (4.0, -3.0, 3.0)},
}
#: Of a week: float32 in g, its clock and its temperature, 8,192 rows a chunk.
MAKE = """
import json, sys, h5py
from imucalib.calibrators.actigraph.simulation import WeekPlan, worn_blocks
path, (days, rate), plant = sys.argv[1], map(float, sys.argv[2:4]), json.loads(sys.argv[4])
with h5py.File(path, "w") as file:
    n, at = round(days * 86400 * rate), 0
    group = file.create_group("accelerometer")
    data = group.create_dataset("data", (n, 3), "f4", chunks=(8192, 3))
    time = group.create_dataset("time", (n,), "f8", chunks=(8192,))
    warm = group.create_dataset("temperature", (n,), "f4", chunks=(8192,))
    for node, unit in ((data, "g"), (time, "s"), (warm, "degC")):
        node.attrs["unit"] = unit
    for block in worn_blocks(WeekPlan(days=days, rate=rate, plant=plant), 1):
        one = block.channels["imu0/acceleration"]
        rows = slice(at, at + one.t.size)
        data[rows], time[rows] = one.values / 9.80665, one.t
        warm[rows] = block.channels["imu0/temperature"].values[:, 0]
        at = rows.stop
"""
LIMIT = """
import hashlib, sys, time, h5py
begin = time.process_time()
with open(sys.argv[1], "rb") as file:
    hashlib.file_digest(file, "sha256")
nodes = []
with h5py.File(sys.argv[1]) as file:
    file.visititems(lambda name, one: nodes.append(one) if isinstance(one, h5py.Dataset) else None)
    for node in nodes:
        for row in range(0, len(node), 1 << 18):
            node[row : row + (1 << 18)]
print(time.process_time() - begin)
"""
#: All that `inspect` cannot do without: every block of a recording.
READ = """
import sys
from imucalib.readers import blocks
for _ in blocks(sys.argv[1]): pass
"""
SKDH = """
import sys, h5py, numpy as np
from skdh.preprocessing import CalibrateAccelerometer
with h5py.File(sys.argv[1]) as file:
    values = file["accelerometer/data"][:].astype(np.float64)
    time = 1.7e9 + file["accelerometer/time"][:]
CalibrateAccelerometer(min_hours=12).predict(time=time, accel=values, fs=100.0)
"""
#: Entries as a batch leaves them, from one: number, folder.
COPY = """
import json, pathlib, sys
entry, folder = json.loads(pathlib.Path(sys.argv[1]).read_text()), pathlib.Path(sys.argv[2])
folder.mkdir()
for k in range(int(sys.argv[3])):
    entry["recording"], entry["row"]["sha256"] = f"/study/{k}.cwa", f"{k:064x}"
    (folder / f"{k}.json").write_text(json.dumps(entry))
"""
ENVIRONMENT = {
    **{name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"},
    "OPENBLAS_NUM_THREADS": "1",
}


def run(*words: object) -> None:
    """What only prepares."""
    subprocess.run([sys.executable, *map(str, words)], check=True, env=ENVIRONMENT)


def cost(*words: object) -> tuple[float, float]:
    """CPU s and peak MB of a command of imucal, with all that it starts."""
    return child_cost(sys.executable, "-m", "imucalib", *words, "-q")


def child_cost(*words: object) -> tuple[float, float]:
    """CPU s and peak MB of any command."""
    typed = [*map(str, words)]
    child = os.posix_spawn(typed[0], typed, ENVIRONMENT)
    _, status, use = os.wait4(child, 0)
    if os.waitstatus_to_exitcode(status) not in (0, 4, 5):
        raise SystemExit(f"{' '.join(typed)} ended with {status}")
    return use.ru_utime + use.ru_stime, use.ru_maxrss / 1024


def limit(path: Path) -> float:
    """CPU s of SHA-256 and one pass."""
    typed = [sys.executable, "-c", LIMIT, str(path)]
    return float(subprocess.run(typed, check=True, capture_output=True, env=ENVIRONMENT).stdout)


def row(what: str, size: float, beside: float, peak: float) -> str:
    return f"| {what} | {size:.2f} | {beside:.2f} | {size / beside:.2f} | {peak:.0f} |"


def weeks(folder: Path, days: float, skdh: str) -> Iterator[str]:
    """A week of each kind, and one that imucal wrote; of the plain one what skdh takes."""
    for name, plant in WEEKS.items():
        path = folder / f"{name.partition(' ')[0]}.h5"
        run("-c", MAKE, path, days, 100.0, json.dumps(plant))
        files = {name: path}
        if not plant:
            files["plain, written by us"] = folder / "written.h5"
            cost("convert", path, folder / "written.h5")
        for kind, file in files.items():
            least, found = limit(file), cost("actigraph", file)
            yield row(f"week of {days:g} d, {kind}; hash and pass", *swap(found, least))
            if skdh and kind == "plain":
                other = child_cost(skdh, "-c", SKDH, file)
                yield row("skdh reads and calibrates it; imucal", *swap(other, found[0]))
            file.unlink()


def swap(found: tuple[float, float], beside: float) -> tuple[float, float, float]:
    """CPU s, what they are held against, peak MB."""
    return found[0], beside, found[1]


def days(folder: Path) -> Iterator[str]:
    """A day that imucal wrote beside its source."""
    source, written = folder / "day.h5", folder / "written.h5"
    run("-c", MAKE, source, 1.0, 100.0, "{}")
    cost("convert", source, written)
    first, _ = cost("actigraph", source, "--no-loop")
    yield row(
        "day written by us; its source", *swap(cost("actigraph", written, "--no-loop"), first)
    )


def inspections(folder: Path) -> Iterator[str]:
    """An hour and a half, which a text table of a day would make many minutes."""
    source = folder / "some.h5"
    run("-c", MAKE, source, 1.0 / 16.0, 100.0, "{}")
    for ending in ("h5", "csv", "mcap"):
        path = folder / f"some.{ending}"
        if path != source:
            cost("convert", source, path)
        alone, _ = child_cost(sys.executable, "-c", READ, path)
        yield row(f"inspect, {ending}; reading", *swap(cost("inspect", path), alone))


def sheets(folder: Path) -> Iterator[str]:
    for rows in (32, 60, 100, 160, 500):
        table = folder / f"{rows}.csv"
        cost("simulate", "lab", table, "--positions", rows, "--layout", "random")
        alone, _ = cost("lab", table, "--no-loop")
        yield row(f"lab of {rows} rows; without its search", *swap(cost("lab", table), alone))


def cohorts(folder: Path) -> Iterator[str]:
    """64 days by two workers beside one alone, a recording; and their entries gathered."""
    days, entries = folder / "days", folder / "entries"
    days.mkdir()
    for k in range(64):
        cost("simulate", "actigraph", days / f"{k}.h5", "--days", 1, "--rate", 10, "--seed", k)
    alone, _ = cost("actigraph", days / "0.h5", "--entry", folder / "entry.json")
    every, peak = cost("batch", days, "-o", entries, "--jobs", 2)
    yield row("a day in a batch of 64; alone", every / 64, alone, peak)
    first = 0.0
    for count in (400, 4000):
        run("-c", COPY, folder / "entry.json", folder / str(count), count)
        spent, peak = cost("collect", folder / str(count), "-o", folder / f"{count}.csv")
        first = first or spent / count
        yield row(
            f"collect, an entry of {count}; of 400, ms", 1e3 * spent / count, 1e3 * first, peak
        )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--days", type=float, default=7.0, help="of a week")
    parser.add_argument(
        "--only", default="weeks days inspections sheets cohorts", help="which of these"
    )
    parser.add_argument("--write", action="store_true", help="into RESULTS.md")
    parser.add_argument("--skdh", default="", help="a Python that has scikit-digital-health")
    given = parser.parse_args()
    load = os.getloadavg()[0]
    lines = [
        f"`python benchmarks/cost.py --days {given.days:g}`, {platform.machine()}, Python "
        f"{platform.python_version()}, load average {load:.1f}; CPU s of whole commands:",
        "",
        "| command; beside | CPU s | beside | times | MB |",
        "|---|---|---|---|---|",
    ]
    kinds = {
        "weeks": lambda folder: weeks(folder, given.days, given.skdh),
        "days": days,
        "inspections": inspections,
        "sheets": sheets,
        "cohorts": cohorts,
    }
    print("\n".join(lines), flush=True)
    for name in given.only.split():
        folder = Path(tempfile.mkdtemp())
        try:
            for line in kinds[name](folder):
                lines.append(line)
                print(line, flush=True)
        finally:
            shutil.rmtree(folder)
    if given.write:
        path = Path(__file__).with_name("RESULTS.md")
        before, mark, rest = path.read_text(encoding="utf-8").partition("<!-- cost.py -->\n")
        after = rest.partition("<!-- end of cost.py -->\n")[2]
        table = "\n".join(lines)
        path.write_text(
            f"{before}{mark}{table}\n<!-- end of cost.py -->\n{after}", encoding="utf-8"
        )


if __name__ == "__main__":
    main()
