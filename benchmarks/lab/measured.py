"""`imucal lab` on measured data: the paper's table under every method, and instruments at rest."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_logs"
REPAIR = ("--fix", "10:y=-58593")


def lab(*arguments: str) -> dict:
    """One run of the command, its JSON."""
    command = [str(Path(sys.executable).parent / "imucal"), "lab", *arguments, "--json", "--quiet"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 5):
        raise SystemExit(f"{' '.join(command)}\n{done.stderr}")
    return json.loads(done.stdout)


def measured(data: Path) -> None:
    """Print the tables."""
    table = str(SAMPLES / "paper_table_1.csv")
    common = (table, *REPAIR, "--gravity", "9.8061")
    rows = [
        ("paper, Table 2 (`--as-published`)", lab(table, *REPAIR, "--as-published")),
        ("paper's objective (5), all rows", lab(*common, "--objective", "paper")),
        ("vector least squares", lab(*common, "--objective", "vector", "--no-loop")),
        ("angles and norm", lab(*common, "--objective", "angles")),
        ("settings as uncertain, no loop", lab(*common, "--no-loop")),
        ("settings as uncertain, loop (default)", lab(*common)),
        ("default, chosen and fitted on rows 1-20", lab(*common, "--train", "1-20")),
        ("the default's model, fitted on rows 1-20", lab(*common, "--train", "1-20", "--no-loop",
         "--declare", "inclination_zero", "--declare", "inclination_scale")),
    ]  # fmt: skip
    quantities = "tool-face, deg | inclination, deg | norm, mg"
    print(f"| Table 1, row 10 repaired (largest / rms) | held out | {quantities} |")
    print("|---|---|---|---|---|")
    for name, report in rows:
        for split in (s for s in report["held_out"] if s["model"] == "final"):
            cells = [
                f"{split[key][0]:.3f} / {split[key][1]:.3f}"
                for key in ("tool_face_deg", "inclination_deg", "norm_mg")
            ]
            print(f"| {name} | {split['split']} | {' | '.join(cells)} |")
    path = ROOT / "tests" / "goldens" / "paper_table_2.csv"
    printed = np.genfromtxt(path, delimiter=",", skip_header=2)
    ours = np.array([p["corrected_m_per_s2"] for p in rows[0][1]["positions"]])
    away = np.abs(ours - printed[:, :3]).max()
    print(f"\nLargest difference to the printed Table 2: {away:.5f} m/s²")
    _default(rows[5][1], lab(table, "--gravity", "9.8061"))
    _instruments(data)


def _default(repaired: dict, printed: dict) -> None:
    record = printed["loop"]["record_errors"][0]
    print(
        f"As printed: {record['where']} {record['channel']} off by {record['size']:.1f} ± "
        f"{record['sd']:.1f} {record['unit']}, likely {record['likely']}."
    )
    curve = {c["inclination_deg"]: c for c in repaired["fixture"]["inclination"]}
    at = curve[50.0]
    print(
        f"Repaired: inclination offset at 50 deg {at['true_minus_dial_deg']:.3f}, 95 % "
        f"{at['low_95_deg']:.3f} to {at['high_95_deg']:.3f}; steps "
        f"{', '.join(s['effect'] for s in repaired['loop']['steps'])}; tool-face setting scatter "
        f"{repaired['noise']['tool_face_setting_deg']:.3f} deg."
    )


def _instruments(data: Path) -> None:
    print("\n| at rest, by the norm | raw, mg | held out base -> final, mg rms | found |")
    print("|---|---|---|---|")
    runs = []
    for path in sorted(SAMPLES.glob("cave_*.csv")):
        runs.append((path.stem.replace("_", " instrument "), lab(str(path), "--reference", "norm")))
    for k in (0, 1):
        log = data / "mpu9150_tumble" / f"imu{k}.log"
        options = ("--reference", "norm", "--acc", "1,2,3", "--unit", "m/s2", "--rate", "100")
        runs.append((f"MPU-9150 tumble {k}", lab(str(log), *options)))
    for name, report in runs:
        error = report["loop"]["errors"][0]
        held = error["held_out"]
        steps = [" or ".join([s["effect"], *s["aliases"]]) for s in report["loop"]["steps"]]
        print(
            f"| {name} | {error['raw']:.2f} | {held['base']:.2f} -> {held['final']:.2f} | "
            f"{'; '.join(steps) or 'nothing'} |"
        )
