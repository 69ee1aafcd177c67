"""A fleet's power, false alarms, sizes and cost, on devices made by plain numpy.

    python benchmarks/lab/fleet.py power [--fleets 100] [--devices 5] [--strength 1.8]
    python benchmarks/lab/fleet.py cost [--devices 1000]

A device: 24 attitudes, reading = matrix force + bias + q force² + 1 mg of noise. `strength` is λ of
the squares in one device: their length in units of the noise with bias, scale and the three cross
terms taken out, from the columns below.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.cohort.fleet.run import run_fleet

COUNT, NOISE = 24, 1.0
REQUEST = replace(LabRequest(), reference="norm")


def directions(rng: np.random.Generator) -> np.ndarray:
    """(COUNT, 3) spread evenly by the golden angle, turned at random."""
    z = 1.0 - (2.0 * np.arange(COUNT) + 1.0) / COUNT
    turn = np.pi * (1.0 + 5.0**0.5) * np.arange(COUNT)
    flat = np.sqrt(1.0 - z**2)
    points = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
    return points @ np.linalg.qr(rng.standard_normal((3, 3)))[0].T


def strength_of(u: np.ndarray, size: np.ndarray) -> float:
    """λ of squares of some sizes (3,), mg/g², in the norm of readings at directions u (n, 3)."""
    base = np.column_stack([u, u**2, u[:, :1] * u[:, 1:], u[:, 1] * u[:, 2]])
    column = (u**3) @ size
    left = column - base @ np.linalg.lstsq(base, column, rcond=None)[0]
    return float(np.linalg.norm(left)) / NOISE


def device(rng: np.random.Generator, strength: float, path: Path) -> np.ndarray:
    """Write a table; its squares (3,), mg/g²: alike within a third, at the strength asked."""
    u = directions(rng)
    size = 1.0 + 0.3 * rng.standard_normal(3)
    size *= strength / strength_of(u, size)
    matrix = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    reading = 1000.0 * u @ matrix.T + 20.0 * rng.standard_normal(3) + size * u**2
    reading = reading + NOISE * rng.standard_normal((COUNT, 3))
    rows = [",".join(f"{v:.3f}" for v in row) for row in reading]
    path.write_text("x (mg),y (mg),z (mg)\n" + "\n".join(rows) + "\n")
    return size


def power(fleets: int, devices: int, strength: float, folder: Path) -> None:
    """How often anything is found, and squares or a rival of them; z of the sizes."""
    for planted in (0.0, strength):
        found = right = 0
        z, covered = list[float](), list[bool]()
        for seed in range(fleets):
            rng = np.random.default_rng((seed, devices))
            paths = [folder / f"{k}.csv" for k in range(devices)]
            truth = [device(rng, planted, path) for path in paths]
            fleet = run_fleet([LabFiles(p) for p in paths], REQUEST, lambda _: None)
            steps = fleet.search.found
            found += bool(steps)
            names = {n for one in steps for n in (one.effect, *one.rivals)}
            right += "quadratic" in names
            own = run_fleet(
                [LabFiles(p) for p in paths], replace(REQUEST, only=("quadratic",)),
                lambda _: None,
            )  # fmt: skip
            if planted and own.search.found:
                for member, size in zip(own.members, truth, strict=True):
                    every = member.recordings[0].calibration.parameters
                    fit = [p for p in every if p.effect == "quadratic"]
                    z += [(p.value - q) / p.sd for p, q in zip(fit, size, strict=True)]
                    covered += [abs(v) < 1.96 for v in z[-3:]]
        line = f"| {devices} | {planted:.1f} | {found} of {fleets} | {right} | "
        if z:
            line += f"{np.sqrt(np.mean(np.square(z))):.2f}, {100 * np.mean(covered):.0f} % |"
        print(line if z else line + "- |", flush=True)


def cost(devices: int, folder: Path) -> None:
    """CPU seconds of calibrating each device, and of the fleet beyond that."""
    rng = np.random.default_rng(0)
    paths = [folder / f"{k}.csv" for k in range(devices)]
    for path in paths:
        device(rng, 1.0, path)
    alone = replace(REQUEST, loop=False)
    start = time.process_time()
    for path in paths:
        calibrate_files(LabFiles(path), alone, lambda _: None)
    between = time.process_time()
    run_fleet([LabFiles(path) for path in paths], REQUEST, lambda _: None)
    each, whole = between - start, time.process_time() - between
    print(f"{devices} devices: {each:.0f} CPU s to calibrate them, {whole - each:.0f} beyond that")


def main() -> None:
    """Print one line a scenario."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["power", "cost"])
    parser.add_argument("--fleets", type=int, default=100)
    parser.add_argument("--devices", type=int, default=5)
    parser.add_argument("--strength", type=float, default=1.8)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if asked.what == "power":
            power(asked.fleets, asked.devices, asked.strength, Path(name))
        else:
            cost(asked.devices, Path(name))


if __name__ == "__main__":
    main()
