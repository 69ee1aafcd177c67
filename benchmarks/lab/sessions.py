"""The stated sd of the next power-up: simulated devices of a few sessions each, and one more.

    python benchmarks/lab/sessions.py [--devices 40] [--sessions 5]

Plain numpy: readings are scale, bias of the power-up and a turn of the mounting, with dials that
scatter; nothing of the package makes them.
"""

from __future__ import annotations

import argparse
import csv
import os
import tempfile
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest

#: Scatter of the bias from power-up to power-up, mg: as of one chip, alike and unlike by axis.
BIAS = {"alike": (0.5, 0.5, 0.5), "unlike": (0.46, 0.25, 0.63)}
TURN, NOISE, DIAL = 0.05, 0.3, 0.03  # deg, mg, deg


def device(
    rng: np.random.Generator, sessions: int, scatter: tuple[float, ...]
) -> tuple[list[tuple[float, ...]], np.ndarray, np.ndarray]:
    """Rows of a table, and bias (mg) and turn (deg) of every power-up, the last of them unseen."""
    matrix = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    bias = np.array(scatter) * rng.standard_normal((sessions + 1, 3))
    bias += 20.0 * rng.standard_normal(3)
    turn = TURN * rng.standard_normal((sessions + 1, 3))
    rows = []
    for session in range(sessions):
        for i in (-60.0, -30.0, 0.0, 30.0, 60.0, 85.0):
            for t in (0.0, 90.0, 180.0, 270.0):
                set_i, set_t = np.radians(np.array([i, t]) + DIAL * rng.standard_normal(2))
                force = np.array(
                    [np.cos(set_i) * np.sin(set_t), np.cos(set_i) * np.cos(set_t), np.sin(set_i)]
                )
                reading = matrix @ force
                reading = reading + np.cross(np.radians(turn[session]), reading)
                reading = 1000.0 * reading + bias[session] + NOISE * rng.standard_normal(3)
                rows.append((float(session), i, t, *reading))
    return rows, bias, turn


def run(devices: int, sessions: int, scatter: tuple[float, ...], folder: Path) -> None:
    """One line of what the devices' next power-ups were beside what was stated."""
    request = LabRequest()
    request = replace(request, loop=False)
    z, inside, own = [], [], []
    for seed in range(devices):
        rows, bias, _ = device(np.random.default_rng((seed, sessions)), sessions, scatter)
        path = folder / f"{seed}.csv"
        with path.open("w", newline="") as out:
            writer = csv.writer(out)
            writer.writerow(("session", "inclination", "tool_face", "x (mg)", "y (mg)", "z (mg)"))
            writer.writerows(rows)
        details = calibrate_files(LabFiles(path), request, lambda _: None).details
        assert details.between_sessions is not None
        after = details.between_sessions.next_power_up
        for k, p in enumerate(p for p in after if p.effect == "bias"):
            off = p.value - bias[-1, k]
            z.append(off / p.sd_next_power_up)
            inside.append(abs(off) <= p.half_of_95)
            own.append(off / p.sd_of_mean)
    print(
        f"| {scatter} mg | {sessions} | {devices} | {np.sqrt(np.mean(np.square(z))):.2f} | "
        f"{100 * np.mean(inside):.1f} % | {np.sqrt(np.mean(np.square(own))):.2f} |",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--devices", type=int, default=40)
    parser.add_argument("--sessions", type=int, nargs="*", default=[2, 3, 5, 10])
    asked = parser.parse_args()
    print("| scatter of the bias | sessions | devices | z rms | 95 % hold | z of the mean's sd |")
    print("|---|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for sessions in asked.sessions:
            for scatter in BIAS.values():
                run(asked.devices, sessions, scatter, Path(folder))


if __name__ == "__main__":
    main()
