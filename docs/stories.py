"""Write the measured stories of `docs/closed_loop.md`: every figure in them comes from here.

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

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_logs"
PAGE = ROOT / "docs" / "closed_loop.md"
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


def steps(report: Report) -> str:
    """What the loop took in, with its evidence."""
    said = []
    for s in (report["loop"] or {"steps": []})["steps"]:
        names = " or ".join(f"`{name}`" for name in (s["effect"], *s["aliases"]))
        if s["effect"].startswith("curve@"):
            what, against, *_, terms = s["effect"].removeprefix("curve@").split(":")
            names = f"a curve without a name, {what} against {against} in {terms} terms"
        size = s.get("size") or ", ".join(
            f"{p['name']} {p['value']:.3g} ± {p['sd']:.2g} {p['unit']}".rstrip(" 1")
            for p in s["parameters"][:3]
        )
        said.append(f"{names} ({size}; {s['evidence_nats']:.1f} nats, p {s['p_value']:.2g})")
    return "; ".join(said) or "nothing"


def left(report: Report) -> str:
    """What stays unexplained, and what drives it."""
    open_end = (report["loop"] or {"unexplained": []})["unexplained"]
    said = [
        f"{u['name']} (driven by {u['driver']})" if u["driver"] else u["name"] for u in open_end
    ]
    return "; ".join(said) or "nothing"


def story(title: str, lines: list[tuple[str, str]]) -> str:
    """A heading and a table of what was asked and found."""
    rows = "\n".join(f"| {name} | {text} |" for name, text in lines)
    return f"### {title}\n\n| | |\n|---|---|\n{rows}\n"


def told(report: Report, before_after: str) -> list[tuple[str, str]]:
    """The common part of every story."""
    return [
        ("verdict", report["loop"]["verdict"] if report["loop"] else "not searched"),
        ("effect and evidence", steps(report)),
        ("error before -> after, on data that took no part", before_after),
        ("left", left(report)),
        ("exit code", str(report["exit_code"])),
    ]


def by_split(report: Report) -> str:
    """Base and final of the last held-out split, rms."""
    last = report["held_out"][-1]["split"]
    base, final = (s for s in report["held_out"] if s["split"] == last)
    said = []
    for key, unit in (("inclination_deg", "deg"), ("tool_face_deg", "deg"), ("norm_mg", "mg")):
        if key in base and base[key] is not None:
            name = key.rsplit("_", 1)[0].replace("_", "-")
            said.append(f"{name} {base[key][1]:.3f} -> {final[key][1]:.3f} {unit}")
    return f"{', '.join(said)} rms ({last})"


def lab(_: Path) -> Iterator[str]:
    """Table 1 of paper 004, as printed, with nothing declared."""
    table, gravity = str(SAMPLES / "paper_table_1.csv"), ("--gravity", "9.8061")
    swapped = run("lab", table, "--swap-angles", *gravity)
    printed, repaired = (
        run("lab", table, *gravity),
        run("lab", table, "--fix", "10:y=-58593", *gravity),
    )
    record = printed["loop"]["record_errors"][0]
    first = [
        ("with its two angle columns as the paper prints them", swapped["error"]),
        ("residual", f"{record['where']}: {record['channel']} is {record['size']:.1f} ± "
         f"{record['sd']:.1f} {record['unit']} off what the others predict"),
        ("likely", record["likely"]),
        *told(printed, by_split(printed)),
    ]  # fmt: skip
    yield story("Paper 004, Table 1, as printed", first)
    fixture = next(f for f in repaired["fixture"]["inclination"] if f["inclination_deg"] == 50.0)
    second = [
        *told(repaired, by_split(repaired)),
        ("the bench's inclination dial", f"{fixture['true_minus_dial_deg']:.2f} deg at 50 deg, "
         f"95 % {fixture['low_95_deg']:.2f} to {fixture['high_95_deg']:.2f}"),
    ]  # fmt: skip
    yield story("The same with the sign of row 10 repaired", second)


def instruments(data: Path) -> Iterator[str]:
    """Cave instruments and hand-turned inertial sensors, by gravity alone."""
    for path in sorted(SAMPLES.glob("cave_*.csv")):
        name = path.stem.removeprefix("cave_")
        report = run("lab", str(path), "--reference", "norm")
        yield story(f"Cave instrument {name}, 24 shots", told(report, by_split(report)))
    columns = ("--acc", "1,2,3", "--unit", "m/s2", "--rate", "100")
    for name in ("imu0", "imu1"):
        path = str(data / "mpu9150_tumble" / f"{name}.log")
        report = run("lab", path, "--reference", "norm", *columns)
        if "error" in report:
            raise SystemExit(report["error"])
        yield story(f"MPU-9150 turned by hand, {name}", told(report, by_split(report)))


def actigraphs(data: Path) -> Iterator[str]:
    """Every worn recording that there is."""
    for path in sorted((data / "actigraph").iterdir()):
        report = run("actigraph", str(path))
        if "error" in report:
            yield story(f"Worn sensor, `{path.name}`", [("refused", report["error"])])
            continue
        e = report["error_mg"]
        rest = report["coverage"]["posture_runs"]
        words = (
            f"raw {e['raw']:.2f}, {e['base_held_out']:.2f} -> {e['final_held_out']:.2f} mg "
            f"mean error of the norm over {rest} posture runs"
        )
        why = [("because", "; ".join(report["reasons"]))] if report["reasons"] else []
        yield story(f"Worn sensor, `{path.name}`", [*told(report, words), *why])


def arrays(data: Path) -> Iterator[str]:
    """A board of 32 inertial sensors, eight of them recorded."""
    for name in ("exp_1", "exp_5"):
        path = str(data / "mimu4444" / f"{name}.h5")
        report = run("array", path, "--board", "mimu4444_corners")
        a, g = (e["held_out"] for e in report["loop"]["errors"])
        words = (
            f"gyros {g['base']:.2f} -> {g['final']:.2f} deg/s, accelerometers "
            f"{a['base']:.3f} -> {a['final']:.3f} m/s² (median absolute deviation)"
        )
        yield story(f"MIMU4444 board, {name}", told(report, words))


def main() -> None:
    """Run everything and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    data = parser.parse_args().data
    parts = [text for part in (lab, instruments, actigraphs, arrays) for text in part(data)]
    page = PAGE.read_text(encoding="utf-8")
    head, tail = page.split(START)[0], page.split(END)[1]
    PAGE.write_text(head + START + "\n\n" + "\n".join(parts) + "\n" + END + tail, encoding="utf-8")


if __name__ == "__main__":
    main()
