"""Write the measured stories of `benchmarks/RESULTS.md`: every figure in them comes from here.

    python docs/stories.py [--data FOLDER]

Runs the command on the recordings of FOLDER (default: `shared/data` beside the repository), one
after another, and replaces what is between the page's markers.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from imucalib.significant_digits import per_cent

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_logs"
PAGE = ROOT / "benchmarks" / "RESULTS.md"
START, END = "<!-- stories: written by docs/stories.py -->", "<!-- end of the stories -->"
Report = dict[str, Any]


def run(*arguments: str) -> Report:
    """One run of the command: its JSON, or {"error": text} where it refused."""
    command = [sys.executable, "-m", "imucalib", *arguments, "--json", "--quiet"]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    if done.returncode not in (0, 4, 5):
        text = done.stderr.strip().splitlines()[-1].partition(": ")[2]
        return {"error": text.replace(f"{Path(arguments[1]).parent}{os.sep}", "")}
    found: Report = json.loads(done.stdout)
    return {"error": found["error"]["message"]} if "error" in found else found


def said(report: Report) -> str:
    """What the loop says: slips, effects with their chance and rivals, what stays."""
    loop, words = report["loop"], []
    words += [f"{f['what']} ({share(f['probability'])})" for f in report.get("faults") or ()]
    words += [f"{r['where']}: {r['likely']}" for r in loop.get("record_errors") or ()]
    for s in loop["steps"]:
        others = [r for r in s["in_its_place"] if r["effect"] != s["effect"]][:2]
        more = [f"`{short(r['effect'])}` {share(r['share'])}" for r in others]
        words.append("; or ".join((f"`{short(s['effect'])}` {share(own(s))}", *more)))
    words += [f"left: {u['name']}" for u in loop["unexplained"]]
    if words:
        return ". ".join(words)
    return "not searched" if loop["verdict"] == "not run" else str(loop["verdict"])


def own(step: Report) -> float:
    """The share of a step's own name; of one without rivals that it is there at all."""
    shares = {r["effect"]: r["share"] for r in step["in_its_place"]}
    return float(shares.get(step["effect"], step["probability"]) if shares else step["probability"])


def short(name: str) -> str:
    """Without the numbers of a law or a curve."""
    return ":".join(name.split(":")[:2])


def share(value: float | None) -> str:
    """In per cent; a slip that was not solved has none."""
    return "unsure" if value is None else per_cent(value)


def row(title: str, report: Report, error: int = 0) -> str:
    """A line of the table: what was recorded, what is said, held-out error, exit code."""
    if "error" in report:
        return f"| {title} | refused: {report['error']} | | |"
    held = report["loop"]["errors"][error]
    before, after = held["held_out"]["base"], held["held_out"]["final"]
    moved = "" if before is None else f"{before:.3g} -> {after:.3g} {held['unit']}"
    return f"| {title} | {said(report)} | {moved} | {report['exit_code']} |"


def lab(_: Path) -> Iterator[str]:
    """Table 1 of paper 004, as printed, with nothing declared."""
    table, gravity = str(SAMPLES / "paper_table_1.csv"), ("--gravity", "9.8061")
    swapped = run("lab", table, "--swap-angles", *gravity)
    yield row("paper 004, Table 1, angle columns as headed", swapped)
    yield row("the same, columns exchanged", run("lab", table, *gravity))
    mended = run("lab", table, "--fix", "10:y=-58593", *gravity)
    yield row("the sign of row 10 mended", mended)


def instruments(data: Path) -> Iterator[str]:
    """Cave instruments and hand-turned inertial sensors, by gravity alone."""
    for path in sorted(SAMPLES.glob("cave_*.csv")):
        report = run("lab", str(path), "--reference", "norm")
        yield row(f"cave instrument {path.stem.removeprefix('cave_')}, 24 shots", report)
    columns = ("--acc", "1,2,3", "--unit", "m/s2", "--rate", "100")
    for name in ("imu0", "imu1"):
        path = str(data / "mpu9150_tumble" / f"{name}.log")
        report = run("lab", path, "--reference", "norm", *columns)
        yield row(f"MPU-9150 turned by hand, {name}", report)


def actigraphs(data: Path) -> Iterator[str]:
    """Every worn recording that there is."""
    for path in sorted((data / "actigraph").iterdir()):
        yield row(f"worn, `{path.name}`", run("actigraph", str(path)))


def arrays(data: Path) -> Iterator[str]:
    """A board of 32 inertial sensors, eight of them recorded; the error of the gyros."""
    for name in ("exp_1", "exp_2", "exp_4", "exp_5"):
        path = str(data / "mimu4444" / f"{name}.h5")
        yield row(f"MIMU4444 board, {name}", run("array", path, "--board", "mimu4444_corners"), 1)


def main() -> None:
    """Run everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    data = parser.parse_args().data
    parts = [text for part in (lab, instruments, actigraphs, arrays) for text in part(data)]
    page = PAGE.read_text(encoding="utf-8")
    head, tail = page.split(START)[0], page.split(END)[1]
    heading = "| recording | what is said | held out, before -> after | exit |\n|---|---|---|---|\n"
    table = heading + "\n".join(parts)
    PAGE.write_text(f"{head}{START}\n\n{table}\n\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
