"""Run the main jobs on the sample logs: what was found, the error before and after, the reports.

python sample_logs/demo.py COMMAND FOLDER
"""

from __future__ import annotations

import json
import os
import resource
import shlex
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from imucalib.effects.forms import in_words
from imucalib.readers import read
from imucalib.rests.segments import still_segments
from imucalib.significant_digits import per_cent
from imucalib.units import MG

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
#: Nothing before this second (s) of the board's log is in its part; local gravity there, m/s².
UNSEEN, GRAVITY = 193.0, 9.8189
#: Seconds between signs of life.
_DOT = 2.0


@dataclass(frozen=True)
class Job:
    """A calibration: the folder of its results, a title, and its arguments."""

    name: str
    title: str
    arguments: tuple[str, ...]


def jobs() -> tuple[Job, ...]:
    """The quick ones first."""
    table = ("lab", "sample_logs/paper_table_1.csv", "--gravity", "9.8061")
    return (
        Job("bench_as_printed", "A bench's table as printed (measured): one of 32 rows is wrong",
            table),
        Job("bench", "The same with that row repaired", (*table, "--fix", "10:y=-58593")),
        Job("rests", "24 positions at rest (generated, with an effect that no file declares)",
            ("lab", "sample_logs/positions.csv", "--recording", "sample_logs/rests.mcap")),
        Job("turns", "One IMU turned by hand from rest to rest (measured)",
            ("imu", "sample_logs/turns.csv.gz")),
        Job("wrist", "A day on the wrist (measured)",
            ("actigraph", "sample_logs/wrist_day.csv.gz")),
        Job("board", "Eight sensors of a board, turned by hand (measured; 12 rests and 65 s of "
            "motion out of 10 min)",
            ("array", "sample_logs/board_part.mcap", "--board", "mimu4444_corners",
             "--gravity", str(GRAVITY))),
    )  # fmt: skip


def imucal(command: str, arguments: list[str]) -> None:
    """One run, its line shown, and a dot while it works; ends the demo where it fails. 5: something
    stays unexplained, or for the user to decide."""
    print(f"$ imucal {shlex.join(arguments)}", flush=True)
    started = subprocess.Popen([command, *arguments, "--quiet", "--force"])
    while started.poll() is None:
        try:
            started.wait(_DOT)
        except subprocess.TimeoutExpired:
            print(".", end="", flush=True)
    print()
    if started.returncode not in (0, 5):
        sys.exit(f"demo failed: exit code {started.returncode}")


def told(report: dict[str, Any]) -> None:
    """What a report says was found, and the error on data that took no part."""
    loop = report["loop"]
    records = [f"wrong record: {r['where']}, {r['channel']} is {r['size']:.0f} ± {r['sd']:.0f} "
               f"{r['unit']} off ({r['likely']})" for r in loop["record_errors"]]  # fmt: skip
    slips = [f["what"] for f in report.get("faults", ())]
    named = [_likely(step) for step in loop["steps"]]
    left = [u["name"].replace("@", ", ") for u in loop["unexplained"]]
    said = "; ".join(slips + records + named) or "nothing missing"
    print(f"found:  {said} ({loop['verdict']})")
    if left:
        print(f"left:   {'; '.join(left[:2])}" + (f" and {len(left) - 2} more" * (len(left) > 2)))
    gain = loop["gain"]
    if gain is None:
        for error in (e for e in loop["errors"] if e["held_out"]["final"] is not None):
            print(
                f"error:  {error['metric']}: raw reading {error['held_out']['raw']:.2g}, "
                f"calibrated {error['held_out']['final']:.2g} {error['unit']}, held out"
            )
        return
    raw = [e["held_out"]["raw"] for e in loop["errors"] if e["unit"] == gain["unit"]][:1]
    first = f"raw reading {raw[0]:.3g}, " if raw and raw[0] is not None else ""
    print(
        f"error:  {first}calibrated {gain['before']:.3g}, with what was found {gain['after']:.3g} "
        f"{gain['unit']}, held out\n        (gain {gain['before'] - gain['after']:.2g}, 95 % "
        f"{gain['low']:.2g} to {gain['high']:.2g})"
    )


def _likely(step: dict[str, Any]) -> str:
    """A step and its first rival, with the probability of each."""
    shares = [(r["effect"], r["share"]) for r in step["in_its_place"]]
    shares = shares or [(step["effect"], step["probability"])]
    return " or ".join(f"{in_words(name)} {per_cent(share)}" for name, share in shares[:2])


def compared(raw: Path, corrected: Path) -> None:
    """|a| against g at the rests of the board's log that its calibration has not seen."""
    before, after = read(raw), read(corrected)
    rests = still_segments(before)
    own = [name for name, c in before.channels.items() if c.quantity == "acceleration"]
    errors = []
    for recording in (before, after):
        triads = [recording.channels[name] for name in own]
        errors.append([
            [np.linalg.norm(c.values[(c.t > a) & (c.t < b)].mean(axis=0)) - GRAVITY for c in triads]
            for a, b in zip(rests.start, rests.stop, strict=True) if b < UNSEEN
        ])  # fmt: skip
    squares = np.mean(np.square(np.array(errors) / MG), axis=2)  # (2, rests)
    draws = np.random.default_rng(0).integers(squares.shape[1], size=(2000, squares.shape[1]))
    means = np.sqrt(squares[:, draws].mean(axis=2))
    low, high = np.percentile(means[0] - means[1], [2.5, 97.5])
    first, last = np.sqrt(squares.mean(axis=1))
    print(
        f"error:  |a| raw {first:.3g}, corrected {last:.3g} mg rms at {squares.shape[1]} rests "
        f"that the calibration has not seen\n        (gain {first - last:.3g}, 95 % {low:.3g} to "
        f"{high:.3g})"
    )


def main(command: str, folder: str) -> None:
    """Run everything; results go below `folder`."""
    command, out = os.path.abspath(command), Path(folder)
    os.chdir(ROOT)
    steps, start = len(jobs()) + 1, time.monotonic()

    def step(number: int, title: str) -> None:
        print(
            f"\n== Step {number} of {steps}, {time.monotonic() - start:.0f} s: {title}", flush=True
        )

    for number, job in enumerate(jobs(), 1):
        step(number, job.title)
        imucal(command, [*job.arguments, "-o", str(out / job.name)])
        told(json.loads((out / job.name / "report.json").read_text(encoding="utf-8")))
        print(f"report: {out / job.name / 'report.html'}")
    step(steps, "The board's whole log, corrected with what its part has taught")
    raw, corrected = Path("sample_logs/board.h5"), out / "board.h5"
    calibration = str(out / "board" / "calibration.yaml")
    imucal(command, ["apply", calibration, str(raw), "-o", str(corrected), "--no-fused"])
    compared(raw, corrected)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    spent = sum(u.ru_utime + u.ru_stime for u in used)
    print(f"\nAll reports are below {out.resolve()} ({spent:.0f} s of CPU time).")
    print(f"Now your own file: {os.path.relpath(command)} FILE says what it is and what to type.")


if __name__ == "__main__":
    main(*sys.argv[1:])
