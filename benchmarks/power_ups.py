"""Several power-ups as one calibration, beside the best of their logs alone.

    python benchmarks/power_ups.py run RESULTS.jsonl [--worlds 40] [--of lab imu] [--no-loop]
    python benchmarks/power_ups.py table RESULTS.jsonl

Two or three power-ups whose bias scatters by 0, 5 or 20 mg an axis, at equal temperatures or at
some that differ by 15 degC; at 5 mg also with a bias that follows the temperature at λ = 8: its
length in units of the noise of the rows, with bias of each power-up, scale and cross terms taken
out. Tables of `lab` are made here, logs of `imu` by `tests/worlds/turned_imu.py`; the command runs
on the files. Each world is a line of RESULTS, so that a run may be cut and taken up again; with
`--no-loop` errors and intervals alone, of worlds without a law.

Error: rms of the gains over what is true (readings per g at 200 directions, mg; per rad, 1e-3), of
the common calibration over that of the log that happens to be best. Bias: of one more power-up.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np

from imucalib.writers import write
from worlds.command import run
from worlds.recordings import recording_of
from worlds.turned_imu import G0, Array, chip, turned

Report = dict  # type: ignore[type-arg]
APART, LAMBDA = (0.0, 5.0, 20.0), 8.0
#: °C of each power-up where they differ; half of what it wanders by within one.
WARM, WANDERS = (15.0, 30.0, 45.0), 2.0
NOISE, DIAL = 0.3, 0.02  # mg, deg of a bench
POSITIONS = [(i, t + i / 2.0) for i in (-60.0, 0.0, 60.0) for t in range(0, 360, 90)]
EVEN = np.random.default_rng(1).standard_normal((200, 3))
EVEN /= np.linalg.norm(EVEN, axis=1)[:, None]


@dataclass(frozen=True)
class Case:
    """count : power-ups; apart : mg; warm : whether temperatures differ; law : whether planted"""

    of: str
    count: int
    apart: float
    warm: bool
    law: bool

    def heats(self) -> tuple[float, ...]:
        return WARM[: self.count] if self.warm else (25.0,) * self.count


@dataclass(frozen=True)
class World:
    """truth : of the IMU's parameters; following : (3,) mg, the bias of one more power-up
    gain : (3, 3) of the bench's readings, of the IMU's corrected rate"""

    paths: list[Path]
    truth: dict[str, float]
    following: Array
    gain: Array


def cases(of: str) -> Iterator[Case]:
    for count, apart, warm in product((2, 3), APART, (False, True)):
        yield Case(of, count, apart, warm, False)
        if apart == 5.0:
            yield Case(of, count, apart, warm, True)


def _strength(base: Array, signal: Array) -> float:
    """λ of a signal, with the columns of a base taken out, both in units of the noise."""
    return float(np.linalg.norm(signal - base @ np.linalg.lstsq(base, signal, rcond=None)[0]))


def _of_sessions(session: Array, columns: Array) -> Array:
    """(n, count k) of columns (n, k), each power-up's own."""
    return np.concatenate([columns * (session == k)[:, None] for k in np.unique(session)], axis=1)


def bench(case: Case, rng: np.random.Generator, folder: Path) -> World:
    """A table of 12 positions a power-up."""
    matrix = np.eye(3) + 0.01 * rng.standard_normal((3, 3))
    bias = 20.0 * rng.standard_normal(3) + case.apart * rng.standard_normal((case.count + 1, 3))
    session = np.repeat(np.arange(case.count), len(POSITIONS))
    dials = np.array(POSITIONS * case.count)
    along = np.linspace(-1.0, 1.0, len(POSITIONS))
    heat = np.concatenate([h + WANDERS * rng.permutation(along) for h in case.heats()])

    def pointing(angles: Array) -> Array:
        i, t = np.radians(angles).T
        return np.column_stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)])

    u = pointing(dials + DIAL * rng.standard_normal(dials.shape))
    warmth = np.zeros((len(u), 3))
    if case.law:
        way = rng.standard_normal(3)
        warmth = (heat - 25.0)[:, None] * way
        # Each axis is read by itself: gravity, and the bias of each power-up.
        base = np.column_stack([pointing(dials), *(session == k for k in range(case.count))])
        sd = np.hypot(NOISE, 1e3 * np.radians(DIAL) / np.sqrt(1.5))
        warmth *= LAMBDA * sd / _strength(base, warmth)
    reading = 1000.0 * u @ matrix.T + bias[session] + warmth
    reading += NOISE * rng.standard_normal(reading.shape)
    head = "session,inclination,tool_face,temperature_C,x (mg),y (mg),z (mg)"
    lines = [
        ",".join((f"{s}", *(f"{v:.4f}" for v in (*d, h, *r))))
        for s, d, h, r in zip(session, dials, heat, reading, strict=True)
    ]
    paths = [folder / "all.csv"]
    paths[0].write_text("\n".join((head, *lines)) + "\n")
    for k in range(case.count):
        paths.append(folder / f"{k}.csv")
        own = [line for line, s in zip(lines, session, strict=True) if s == k]
        paths[-1].write_text("\n".join((head, *own)) + "\n")
    return World(paths, {}, bias[-1], matrix)


def log(case: Case, rng: np.random.Generator, folder: Path) -> World:
    """A log of 12 rests a power-up."""
    own = chip(rng)
    bias = own.force_bias + 1e-3 * case.apart * rng.standard_normal((case.count + 1, 3))
    slope, logs, heats = rng.standard_normal(3), [], []
    for k, warm in enumerate(case.heats()):
        made = turned(replace(own, force_bias=bias[k]), rng, rests=12)
        heats.append(warm + WANDERS * np.sin(2.0 * np.pi * made.t / rng.uniform(15.0, 60.0)))
        logs.append(made)
    rest, heat, sd, session = [], [], [], []
    for k, made in enumerate(logs):
        for a, b in made.still:
            inside = (made.t > a) & (made.t < b)
            rest.append(made.up[inside].mean(axis=0))
            heat.append(heats[k][inside].mean())
            sd.append(own.force_noise / np.sqrt(inside.sum()))
            session.append(k)
    u, noise = np.array(rest), np.array(sd)
    # At rest the norm is read: u'bias, u'S u.
    base = np.column_stack(
        [_of_sessions(np.array(session), u), u**2, u[:, :1] * u[:, 1:], u[:, 1] * u[:, 2]]
    )
    signal = (np.array(heat) - 25.0) * (u @ slope)
    slope *= case.law * LAMBDA / _strength(base / noise[:, None], signal / noise)
    paths = []
    for k, made in enumerate(logs):
        force = made.force + (heats[k] - 25.0)[:, None] * slope
        thermometer = heats[k] + 0.01 * rng.standard_normal(len(made.t))
        paths.append(folder / f"{k}.h5")
        write(recording_of(made.t, G0 * force, made.rate, thermometer, hz=100.0), paths[-1])
    gain, axes = np.linalg.inv(own.M), "xyz"
    truth = {
        f"gyro_gain_{a}{b}": gain[i, j] for i, a in enumerate(axes) for j, b in enumerate(axes)
    }
    truth |= {f"scale_{a}": own.S[i, i] - 1.0 for i, a in enumerate(axes)}
    return World(paths, truth, 1e3 * bias[-1], gain)


def calibrated(of: str, *arguments: object) -> Report:
    result = run(of, *arguments, "--json", "-q")
    if result.exception is not None:
        raise result.exception
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def error(content: Report, world: World, of: str) -> float:
    """Of the gains: mg at even directions on a bench, 1e-3 of the IMU's gyroscope."""
    value = {p["name"]: p["value"] for p in content["parameters"]}
    if of == "imu":
        gain = np.array([[value[f"gyro_gain_{a}{b}"] for b in "xyz"] for a in "xyz"])
        return float(1e3 * np.sqrt(np.mean((gain - world.gain) ** 2)))
    away = np.array(_matrix(content)["M"]) @ world.gain - np.eye(3)
    return float(1e3 * np.sqrt(np.mean((EVEN @ away.T) ** 2)))


def _matrix(content: Report) -> Report:
    return content["matrices"]["corrected_from_raw"]  # type: ignore[no-any-return]


def off(content: Report, world: World, of: str) -> list[float]:
    """Errors over what is stated, of the bench's matrix, of the IMU's gains and scales."""
    if of == "lab":
        made = _matrix(content)
        away = np.array(made["M"]) - np.linalg.inv(world.gain)
        return list((away / np.array(made["M_sd"])).ravel())
    found = {p["name"]: p for p in content["parameters"]}
    return [(found[n]["value"] - v) / found[n]["sd"] for n, v in world.truth.items()]


def tried(case: Case, seed: int, loop: bool) -> Report:
    """A line of results."""
    key = (seed, case.of == "imu", case.count, int(case.apart), case.warm, case.law)
    start = time.process_time()
    with tempfile.TemporaryDirectory() as name:
        make = log if case.of == "imu" else bench
        world = make(case, np.random.default_rng([int(k) for k in key]), Path(name))
        logs = world.paths if case.of == "imu" else world.paths[1:]
        together = logs if case.of == "imu" else world.paths[:1]
        whole = calibrated(case.of, *together, *([] if loop else ["--no-loop"]))
        alone = [calibrated(case.of, path, "--no-loop") for path in logs]
    after = whole["between_sessions"]["next_power_up"]
    after = [one for one in after if one["parameter"].startswith("bias_")]
    steps = whole["loop"]["steps"] if loop else []
    return {
        "case": vars(case), "seed": seed, "loop": loop, "error": error(whole, world, case.of),
        "alone": [error(one, world, case.of) for one in alone], "status": whole["status"],
        "z": off(whole, world, case.of),
        "next": [
            bool(abs(one["value"] - true) <= one["half_of_95"])
            for one, true in zip(after, world.following, strict=True)
        ],
        "told": [[s["effect"], *s["aliases"]] for s in steps],
        "certain": [s["certain"] for s in steps],
        "left": [one["name"] for one in whole["loop"]["unexplained"]] if loop else [],
        "reasons": whole["reasons"], "cpu": time.process_time() - start,
    }  # fmt: skip


def table(lines: list[Report]) -> None:
    heads = (
        "calibrator", "power-ups", "apart, mg", "temperatures", "law", "worlds", "searched",
        "error / best log: median, 95 %, max", "95 % hold", "next bias", "law named",
        "lag beside", "others told", "not ok",
    )  # fmt: skip
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for of in ("lab", "imu"):
        for case in cases(of):
            own = [x for x in lines if x["case"] == vars(case)]
            if not own:
                continue
            ratio = np.array([x["error"] / min(x["alone"]) for x in own])
            z = np.abs([v for x in own for v in x["z"]])
            following = [v for x in own for v in x["next"]]
            whole = [x for x in own if x.get("loop", True)]
            named = [any("temperature_bias" in place for place in x["told"]) for x in whole]
            lag = [any(p[0].startswith("thermal_lag") for p in x["told"]) for x in whole]
            other = [
                any("temperature_bias" not in p for p in x["told"]) or bool(x["left"])
                for x in whole
            ]
            cells = (
                of, case.count, f"{case.apart:g}", "differ" if case.warm else "equal",
                "λ 8" if case.law else "none", len(own), len(whole),
                f"{np.median(ratio):.2f}, {np.quantile(ratio, 0.95):.2f}, {ratio.max():.2f}",
                f"{100 * np.mean(z < 1.96):.1f} % of {z.size}", f"{100 * np.mean(following):.0f} %",
                sum(named), sum(lag), sum(other), sum(x["status"] != "ok" for x in own),
            )  # fmt: skip
            print("| " + " | ".join(str(cell) for cell in cells) + " |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("results", type=Path)
    parser.add_argument("--worlds", type=int, default=40)
    parser.add_argument("--of", nargs="*", default=["lab", "imu"])
    parser.add_argument("--no-loop", dest="loop", action="store_false")
    asked = parser.parse_args()
    text = asked.results.read_text() if asked.results.exists() else ""
    lines = [json.loads(line) for line in text.splitlines()]
    if asked.what == "table":
        table(lines)
        return
    had = {(json.dumps(x["case"]), x["seed"]) for x in lines}
    with asked.results.open("a") as out:
        every = [case for both in zip(*map(cases, asked.of), strict=True) for case in both]
        for seed, case in product(range(asked.worlds), every):
            wanted = asked.loop or not case.law
            if wanted and (json.dumps(vars(case)), seed) not in had:
                out.write(json.dumps(tried(case, seed, asked.loop)) + "\n")
                out.flush()


if __name__ == "__main__":
    main()
