"""The next device of a kind, from few rests beside its fleet, on devices made by plain numpy.

    python benchmarks/lab/next_device.py [--fleets 40] [--devices 5 20] [--rests 24] [--next 3]
    python benchmarks/lab/next_device.py measured

A device: reading = matrix force + bias + q force² + 1 mg of noise, read at evenly spread attitudes;
`wide` and `narrow` are how much devices differ. The error is that of |a| at attitudes never seen.
`measured`: each cave instrument by a fleet of the other four, rows drawn at random, judged on the
other rows.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imucalib.calibrators.lab.files import LabFiles, calibrate_files
from imucalib.calibrators.lab.request import LabRequest
from imucalib.calibrators.lab.run import LabRun
from imucalib.calibrators.population import Population
from imucalib.cohort.fleet.run import run_fleet
from imucalib.core.effect import Context
from imucalib.core.fit import Fit
from imucalib.posterior.held_out import errors
from imucalib.units import MG

REQUEST = replace(LabRequest(), reference="norm")
#: Scatter of bias (mg) and of scale and cross terms between devices.
KINDS = {"wide": (20.0, 0.01), "narrow": (3.0, 0.002)}
RESTS = (6, 9, 12, 24)
SAMPLES = Path(__file__).parents[2] / "sample_logs"


@dataclass(frozen=True)
class Device:
    matrix: np.ndarray
    bias: np.ndarray
    squares: np.ndarray

    def reading(self, u: np.ndarray) -> np.ndarray:
        """(n, 3) mg at directions (n, 3)."""
        return 1000.0 * u @ self.matrix.T + self.bias + self.squares * u**2

    def write(self, path: Path, count: int, rng: np.random.Generator) -> Path:
        z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
        turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
        flat = np.sqrt(1.0 - z**2)
        points = np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])
        u = points @ np.linalg.qr(rng.standard_normal((3, 3)))[0].T
        rows = self.reading(u) + rng.standard_normal((count, 3))
        text = "\n".join(",".join(f"{v:.3f}" for v in row) for row in rows)
        path.write_text(f"x (mg),y (mg),z (mg)\n{text}\n")
        return path

    def error(self, fit: Fit) -> float:
        """mg rms of |a| at 300 attitudes."""
        u = np.random.default_rng(1).standard_normal((300, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        force = fit.model.correct(fit.theta, MG * self.reading(u)[:, None], Context(300))
        return float(np.sqrt(np.mean((np.linalg.norm(force[:, 0], axis=1) / MG - 1000.0) ** 2)))

    def z(self, fit: Fit) -> np.ndarray:
        """Errors of the nine parameters over their stated sds."""
        m = self.matrix
        truth = np.array([*self.bias, *(np.diag(m) - 1.0), m[1, 0], m[2, 0], m[2, 1]])
        return np.asarray((fit.theta[:9] - truth) / fit.sd[:9])


def device(rng: np.random.Generator, kind: str) -> Device:
    bias, share = KINDS[kind]
    matrix = np.eye(3) + share * np.tril(rng.standard_normal((3, 3)))
    return Device(matrix, bias * rng.standard_normal(3), 2.0 + 0.6 * rng.standard_normal(3))


def calibrated(path: Path, kind: Population | None, train: tuple[int, ...] = ()) -> LabRun:
    """With a fleet's word, or alone without a search."""
    return calibrate_files(
        LabFiles(path), replace(REQUEST, population=kind, loop=False, train=train), lambda _: None
    )


def fleet_of(paths: list[Path]) -> Population:
    found = run_fleet([LabFiles(p) for p in paths], REQUEST, lambda _: None)
    assert found.following is not None
    return found.following


def next_ones(devices: int, rests: int, kind: str, seed: int, following: int, folder: Path) -> dict:  # type: ignore[type-arg]
    """A fleet of devices with so many rests each, and ones that follow it."""
    rng = np.random.default_rng((seed, len(kind), devices, rests))
    paths = [device(rng, kind).write(folder / f"{k}.csv", rests, rng) for k in range(devices)]
    told = fleet_of(paths)
    found = {"kind": kind, "devices": devices, "rests": rests, "seed": seed, "next": []}
    for _ in range(following):
        one = device(rng, kind)
        runs, alone = [], []
        for count in RESTS:
            path = one.write(folder / "new.csv", count, rng)
            runs.append(calibrated(path, told).result)
            if count > 9:
                alone.append(one.error(calibrated(path, None).result.final))
        found["next"].append({
            "beside": [one.error(r.final) for r in runs], "alone": alone,
            "z": [one.z(r.final).tolist() for r in runs], "chance": runs[0].kind_chance,
            "prior": told_of(told, one),
        })  # fmt: skip
    return found


def told_of(told: Population, one: Device) -> list[float]:
    """Errors of the prior itself over its sd, of bias, scale and cross terms."""
    m = one.matrix
    truth = [*one.bias, *(np.diag(m) - 1.0), m[1, 0], m[2, 0], m[2, 1]]
    every = zip(told.parameters[:9], truth, strict=True)
    return [float((v - p.mean) / p.sd) for p, v in every]


def table(lines: list[dict]) -> None:  # type: ignore[type-arg]
    heads = (
        "devices", "of rests", "differ", "next ones", *(f"{n} rests" for n in RESTS),
        "12, 24 alone", "95 % hold: the prior alone", f"{RESTS[0]} rests", f"{RESTS[-1]} rests",
        "told strange",
    )  # fmt: skip
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for devices, rests, kind in sorted({(x["devices"], x["rests"], x["kind"]) for x in lines}):
        own = [x for x in lines if (x["devices"], x["rests"], x["kind"]) == (devices, rests, kind)]
        ones = [one for x in own for one in x["next"]]
        rms = np.sqrt(np.mean(np.square([one["beside"] for one in ones]), axis=0))
        alone = np.sqrt(np.mean(np.square([one["alone"] for one in ones]), axis=0))
        z = np.array([one["z"] for one in ones])
        held = [np.array([one["prior"] for one in ones]), z[:, 0], z[:, -1]]
        print("| " + " | ".join((
            f"{devices} | {rests} | {kind} | {len(ones)} of {len(own)}",
            *(f"{v:.2f} mg" for v in rms), ", ".join(f"{v:.2f}" for v in alone) + " mg",
            *(f"{100 * np.mean(np.abs(h) < 1.96):.1f} % (z {np.sqrt(np.mean(h**2)):.2f})"
              for h in held),
            f"{sum(one['chance'] < 0.01 for one in ones)}",
        )) + " |")  # fmt: skip


def simulated(
    fleets: int, devices: list[int], rests: list[int], following: int, results: Path
) -> None:
    """Each fleet is a line of the results, so that a run may be cut and taken up again."""
    text = results.read_text() if results.exists() else ""
    lines = [json.loads(line) for line in text.splitlines()]
    had = {(x["devices"], x["rests"], x["kind"], x["seed"]) for x in lines}
    with tempfile.TemporaryDirectory() as folder, results.open("a") as out:
        for seed, *case in product(range(fleets), devices, rests, KINDS):
            if (*case, seed) not in had:
                lines.append(next_ones(*case, seed, following, Path(folder)))
                out.write(json.dumps(lines[-1]) + "\n")
                out.flush()
    table(lines)


def measured(repeats: int = 12) -> None:
    paths = sorted(SAMPLES.glob("cave_*.csv"))
    heads = ("instrument", "6 rests", "9", "12", "12 alone", "all 24 alone, held out")
    print("| " + " | ".join(heads) + " |")
    print("|---" * len(heads) + "|")
    for path in paths:
        kind = fleet_of([p for p in paths if p != path])
        whole = calibrated(path, None)
        data = whole.result.final.observations
        cells = []
        for count, prior in ((6, kind), (9, kind), (12, kind), (12, None)):
            sizes = []
            for seed in range(repeats):
                pick = np.sort(np.random.default_rng(seed).permutation(data.n)[:count])
                fit = calibrated(path, prior, tuple(int(k) + 1 for k in pick)).result.final
                rest = data.take(np.setdiff1d(np.arange(data.n), pick))
                sizes.append(errors(fit, fit.theta, rest).rms() / MG)
            cells.append(f"{np.median(sizes):.2f}")
        print(f"| {path.stem} | {' | '.join(cells)} | {whole.outcome.error.held_out.final:.2f} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", default="simulated", choices=["simulated", "measured"])
    parser.add_argument("--fleets", type=int, default=40)
    parser.add_argument("--devices", type=int, nargs="*", default=[5, 20])
    parser.add_argument("--rests", type=int, nargs="*", default=[24])
    parser.add_argument("--next", type=int, default=3)
    parser.add_argument("--results", type=Path, default=Path("next_device.jsonl"))
    chosen = parser.parse_args()
    if chosen.what == "measured":
        measured()
        return
    simulated(chosen.fleets, chosen.devices, chosen.rests, chosen.next, chosen.results)


if __name__ == "__main__":
    main()
