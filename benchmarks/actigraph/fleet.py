"""A fleet of worn sensors: power, false alarms, sizes, scatter, the next device, cost.

    python benchmarks/actigraph/fleet.py power [--fleets 40] [--devices 5] [--size 0 0.03 0.06]
    python benchmarks/actigraph/fleet.py next [--fleets 4] [--devices 8]
    python benchmarks/actigraph/fleet.py cost [--devices 1000]

A device is made by plain numpy: two recordings of a day, 200 posture runs about few habits each, a
temperature that follows the hour and cools while the device is not worn, 0.5 mg from run to run and
a bias that wanders by 0.5 mg in an hour. Devices differ by 20 mg of bias and 1 % of scale
(`narrow`: 3 mg and 0.2 %), their kind is off by as much as the first, recordings of one device
differ by 1 mg of bias. `size` is what the temperature does, mg/degC on every axis, alike within a
third.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imucalib.calibration.sums import KEY, sums_of
from imucalib.calibrators.actigraph.errors import norm_sd
from imucalib.calibrators.actigraph.request import ActigraphRequest
from imucalib.calibrators.actigraph.run import run_of
from imucalib.calibrators.actigraph.simulation import postures, scan_of
from imucalib.calibrators.population import UNLIKELY, Population, read, to_yaml
from imucalib.calibrators.result import describe_run
from imucalib.cohort.fleet.recorded import Wanted, run_recorded
from imucalib.core.effect import Context
from imucalib.core.sphere import even_directions
from imucalib.effects import named
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG

DAY, SCATTER, WANDER, HOUR = 86400.0, 0.5, 0.5, 3600.0
REQUEST = ActigraphRequest()


@dataclass(frozen=True)
class Device:
    """reading = matrix f + bias + size (T - 25), mg"""

    matrix: np.ndarray
    bias: np.ndarray
    size: np.ndarray

    def runs(self, count: int, rng: np.random.Generator, days: float = 1.0) -> tuple:
        """Posture runs, their scan, and the device as it was in that recording."""
        time_ = np.sort(rng.uniform(0.0, days * DAY, count))
        warm = warmth(time_, rng.uniform(0.0, DAY)) + 0.3 * rng.standard_normal(count)
        u = postures(count, rng)
        gap = np.diff(time_, prepend=time_[0])
        walk = np.zeros((count, 3))
        for k in range(count):  # Ornstein-Uhlenbeck at uneven times
            keep = np.exp(-gap[k] / HOUR) if k else 0.0
            step = WANDER * np.sqrt(1.0 - keep**2) * rng.standard_normal(3)
            walk[k] = keep * walk[k - 1] + step
        now = replace(self, bias=self.bias + rng.standard_normal(3))
        reading = 1000.0 * u @ self.matrix.T + now.bias + self.size * (warm - 25.0)[:, None]
        reading = reading + walk + SCATTER * rng.standard_normal((count, 3))
        runs = PostureRuns(
            mean=reading * MG, windows=np.full(count, 6, np.intp), time=time_, temperature=warm,
            window_noise=0.1 * MG, still=6 * count, total=12 * count, noise=np.full(3, 4.0 * MG),
        )  # fmt: skip
        grid = np.arange(5.0, days * DAY, 60.0)
        series = np.interp(grid, time_, warm)
        return runs, scan_of(grid, series, rate=100.0, seconds=days * DAY), now

    def error(self, fit) -> float:
        """mg rms of |a| at 300 attitudes and 30 degC."""
        u = np.random.default_rng(1).standard_normal((300, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        reading = 1000.0 * u @ self.matrix.T + self.bias + self.size * 5.0
        context = Context(300, {"temperature": np.full(300, 30.0)})
        force = fit.model.correct(fit.theta, MG * reading[:, None], context)
        return float(np.sqrt(np.mean((np.linalg.norm(force[:, 0], axis=1) / MG - 1000.0) ** 2)))


def warmth(time_: np.ndarray, start: float) -> np.ndarray:
    off = np.mod(time_ + start, DAY) < 0.25 * DAY
    return 31.0 + 1.5 * np.sin(2.0 * np.pi * (time_ + start) / DAY) - 6.0 * off


@dataclass(frozen=True)
class Kind:
    """What devices of a kind have on average, and their scatter: mg of bias, share of scale."""

    matrix: np.ndarray
    bias: np.ndarray
    scatter: tuple[float, float]

    def device(self, rng: np.random.Generator, size: float) -> Device:
        bias, share = self.scatter
        matrix = self.matrix + share * np.tril(rng.standard_normal((3, 3)))
        own = size * (1.0 + 0.3 * rng.standard_normal(3))
        return Device(matrix, self.bias + bias * rng.standard_normal(3), own)


KINDS = {"wide": (20.0, 0.01), "narrow": (3.0, 0.002)}


def kind_of(name: str, rng: np.random.Generator) -> Kind:
    """A kind off by 20 mg and 1 %."""
    matrix = np.eye(3) + 0.01 * np.tril(rng.standard_normal((3, 3)))
    return Kind(matrix, 20.0 * rng.standard_normal(3), KINDS[name])


def recorded(one: Device, name: str, folder: Path, rng: np.random.Generator) -> Path:
    """The report of a recording, as `imucal batch` keeps it."""
    runs, scan, _ = one.runs(200, rng)
    run = run_of(runs, replace(scan, path=name, sha256=name), REQUEST, lambda _: None)
    path = folder / f"{name}.json"
    path.write_text(json.dumps(describe_run(run)))
    return path


def made(kind: Kind, rng: np.random.Generator, devices: int, size: float, folder: Path) -> tuple:
    """Devices, entries of two recordings each, and the table of who is who."""
    every = [kind.device(rng, size) for _ in range(devices)]
    paths, rows = [], ["recording,device"]
    for k, one in enumerate(every):
        for part in "ab":
            paths.append(recorded(one, f"d{k}{part}", folder, rng))
            rows.append(f"d{k}{part},d{k}")
    table = folder / "devices.csv"
    table.write_text("\n".join(rows) + "\n")
    return every, paths, table


def power(fleets: int, devices: int, sizes: list[float], folder: Path) -> None:
    """How often anything is found, and the temperature; z of sizes; scatter of biases."""
    typical = named("temperature_bias").parameters(Context(1))[0].typical
    for planted in sizes:
        found, right, alone, z, between, within, strength = 0, 0, 0, [], [], [], []
        for seed in range(fleets):
            rng = np.random.default_rng((seed, devices))
            every, paths, table = made(kind_of("wide", rng), rng, devices, planted, folder)
            for k, path in enumerate(paths):
                content = json.loads(path.read_text())
                alone += "temperature_bias" in [s["effect"] for s in content["loop"]["steps"]]
                strength.append(strength_of(content, every[k // 2].size / typical))
            fleet = run_recorded(paths, Wanted(devices=table), lambda _: None)
            names = {n for one in fleet.search.found for n in (one.effect, *one.rivals)}
            found += bool(fleet.search.found)
            right += "temperature_bias" in names
            own = [s for s in fleet.spreads if s.name.startswith("bias")]
            between += [s.scatter**2 for s in own]
            within += [s.sessions.sd**2 for s in own]
            for one in fleet.search.found:
                if one.effect == "temperature_bias":
                    sds = np.sqrt(np.einsum("dii->di", one.sizes.covariance))
                    truth = np.array([d.size for d in every]) / typical
                    z += list(((one.sizes.each - truth) / sds).ravel())
        spread = "-"
        if z:
            inside = 100 * np.mean(np.abs(z) < 1.96)
            spread = f"{np.sqrt(np.mean(np.square(z))):.2f}, {inside:.0f} %"
        of_device = np.sqrt(2.0) * np.median(strength)
        cells = [
            devices, planted, f"{of_device:.1f}", f"{found} of {fleets}", right,
            f"{alone} of {2 * devices * fleets}", spread, f"{np.sqrt(np.mean(between)):.1f}",
            f"{np.sqrt(np.mean(within)):.2f}",
        ]  # fmt: skip
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def strength_of(content: dict, size: np.ndarray) -> float:
    """λ of the planted size in one recording, under the noise that was estimated."""
    sums = sums_of(content[KEY])
    at = sums.blocks["temperature_bias"]
    return float(np.sqrt(size @ sums.gram[np.ix_(at, at)] @ size))


def following(fleets: int, devices: int, folder: Path) -> None:
    """The next device from few postures, with and without the fleet."""
    print("| devices differ | postures | alone, mg | beside the fleet, mg | sd of the worst |a| | "
          "z rms | told strange |")  # fmt: skip
    print("|---" * 7 + "|")
    for name in KINDS:
        rows: dict[int, list[list]] = {n: [] for n in (4, 6, 9, 15)}
        for seed in range(fleets):
            rng = np.random.default_rng((seed, devices, len(name)))
            kind = kind_of(name, rng)
            _, paths, table = made(kind, rng, devices, 0.05, folder)
            fleet = run_recorded(paths, Wanted(devices=table), lambda _: None)
            file = folder / "fleet.yaml"
            file.write_text(to_yaml(fleet.following))
            told = read(file)
            for _ in range(8):
                one = kind.device(rng, 0.05)
                for n, row in rows.items():
                    row.append(trial(one, n, told, rng))
        for n, row in rows.items():
            alone, beside, before, now, z, strange = zip(*row, strict=True)
            errors = [float(np.sqrt(np.mean(np.square(v)))) for v in (alone, beside)]
            sds = f"{np.median(before):.1f} -> {np.median(now):.1f} mg"
            rms = float(np.sqrt(np.mean(np.square(np.concatenate(z)))))
            print(f"| {name} | {n} | {errors[0]:.1f} | {errors[1]:.1f} | {sds} | {rms:.2f} | "
                  f"{sum(strange)} of {len(strange)} |", flush=True)  # fmt: skip


def trial(one: Device, count: int, told: Population, rng: np.random.Generator) -> list:
    """Errors and sds of the worst |a|, mg, alone and beside the fleet; z; whether it is strange."""
    runs, scan, now = one.runs(count, rng, 0.2)
    plain = replace(REQUEST, loop=False)
    alone = run_of(runs, scan, plain, lambda _: None).result.final
    result = run_of(runs, scan, replace(plain, kind=told), lambda _: None).result
    fit, matrix = result.final, now.matrix
    truth = np.concatenate([now.bias, np.diag(matrix) - 1.0, matrix[[1, 2, 2], [0, 0, 1]]])
    sds = [float(norm_sd(f, even_directions()).max()) / MG for f in (alone, fit)]
    z = (fit.theta[:9] - truth) / fit.sd[:9]
    return [now.error(alone), now.error(fit), *sds, z, result.of_a_kind.chance < UNLIKELY]


def cost(devices: int, folder: Path) -> None:
    """CPU seconds of the fleet, calibrations aside: every entry is one of ten, under new names."""
    rng = np.random.default_rng(0)
    _, paths, _ = made(kind_of("wide", rng), rng, 5, 0.03, folder)
    texts = [p.read_text() for p in paths]
    every = []
    for k in range(devices):
        content = json.loads(texts[k % len(texts)])
        content["provenance"] |= {"input": f"x{k}", "sha256": f"x{k}"}
        every.append(folder / f"x{k}.json")
        every[-1].write_text(json.dumps(content))
    start = time.process_time()
    run_recorded(every, Wanted(), lambda _: None)
    print(f"{devices} recordings: {time.process_time() - start:.0f} CPU s")


def main() -> None:
    """Print one line a scenario."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["power", "next", "cost"])
    parser.add_argument("--fleets", type=int, default=40)
    parser.add_argument("--devices", type=int, default=0)
    parser.add_argument("--size", type=float, nargs="+", default=[0.0, 0.03, 0.06])
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if asked.what == "power":
            power(asked.fleets, asked.devices or 5, asked.size, Path(name))
        elif asked.what == "next":
            following(asked.fleets, asked.devices or 8, Path(name))
        else:
            cost(asked.devices or 1000, Path(name))


if __name__ == "__main__":
    main()
