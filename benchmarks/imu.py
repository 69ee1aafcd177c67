"""The marks of `imucal imu` on logs whose truth is known, and beside plain least squares.

    python benchmarks/imu.py [--logs 100] [--seed 1] [--jobs 2]

Chips, turns and readings are made in plain numpy (`tests/worlds/turned_imu.py`): 10 to 24 rests of
2 to 3.2 s, turned by hand with a wobble across the axis, half of them in a hand that trembles, at
100 to 400 Hz, the gyroscope of a third at a rate of its own. The command runs on the files.
Plain least squares, written here, knows the rests: the norm for the accelerometer, then nine gains
by gravity carried with trapezoids, every turn alike.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import numpy as np
from click.testing import CliRunner, Result
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from imucalib import cli
from imucalib.errors import ImucalError
from imucalib.recording.recording import Channel, Recording
from imucalib.writers import write
from worlds.turned_imu import G0, Array, Chip, Log, chip, turned

DEG = np.pi / 180.0
RATES = (100.0, 200.0, 400.0)
FOLDS = 5
Job = Callable[..., dict[str, object]]


@dataclass(frozen=True)
class World:
    chip: Chip
    log: Log


def world(seed: int, rests: int | None = None, **planted: object) -> World:
    rng = np.random.default_rng(seed)
    own = chip(rng, **planted)
    rate = float(rng.choice(RATES))
    log = turned(
        own, rng, rests=rests or int(rng.integers(10, 25)), seconds=2.5, rate=rate,
        gyro_rate=float(rng.choice(RATES)) if rng.random() < 0.5 else None,
        coning=rng.uniform(0.0, 0.6), tremor=float(rng.choice([0.0, 0.003])),
    )  # fmt: skip
    return World(own, log)


def written(log: Log, path: Path) -> Path:
    rates = (1.0 / np.median(np.diff(t)) for t in (log.t, log.t_gyro))
    channels = {
        f"imu0/{quantity}": Channel(t, values, unit, quantity, "imu0", float(rate))
        for quantity, unit, t, values, rate in zip(
            ("acceleration", "angular_rate"), ("m/s2", "rad/s"), (log.t, log.t_gyro),
            (G0 * log.force, log.rate), rates, strict=True,
        )
    }  # fmt: skip
    write(Recording(channels, "world", "hdf5", ""), path)
    return path


def command(*arguments: object) -> Result:
    words = ["imu", *(str(a) for a in arguments), "--json", "-q"]
    return CliRunner().invoke(cli.cli, words, standalone_mode=False)


def report(log: Log, *arguments: object) -> dict:  # type: ignore[type-arg]
    with tempfile.TemporaryDirectory() as folder:
        result = command(written(log, Path(folder) / "log.h5"), *arguments)
    if result.exception is not None:
        raise result.exception
    return json.loads(result.stdout)  # type: ignore[no-any-return]


def truth(own: Chip) -> dict[str, float]:
    """The parameters of calibration.yaml."""
    gain, axes = np.linalg.inv(own.M), "xyz"
    found = {
        f"gyro_gain_{a}{b}": gain[i, j] for i, a in enumerate(axes) for j, b in enumerate(axes)
    }
    for i, axis in enumerate(axes):
        found |= {f"bias_{axis}": 1e3 * own.force_bias[i], f"scale_{axis}": own.S[i, i] - 1.0}
    return found


def off(content: dict, own: Chip) -> dict[str, float]:  # type: ignore[type-arg]
    """Errors over what is stated."""
    true = truth(own)
    return {
        p["name"]: (p["value"] - true[p["name"]]) / p["sd"]
        for p in content["parameters"]
        if p["name"] in true
    }


def told(content: dict) -> list[tuple[str, bool]]:  # type: ignore[type-arg]
    loop = content["loop"]
    steps = [(s["effect"], s["certain"]) for s in loop["steps"]]
    return [*steps, *((u["name"], False) for u in loop["unexplained"])]


def clean(seed: int) -> dict[str, object]:
    made = world(seed)
    content = report(made.log)
    held = content["loop"]["errors"][0]["held_out"]
    return {
        "z": off(content, made.chip), "told": told(content), "final": held["final"],
        "plain": held_out(made.log), "rests": len(made.log.still),
    }  # fmt: skip


#: mg a typical size of what an accelerometer adds to each axis, of gravity (n, 3) and the share
#: (n, 1) of the log.
OF_FORCE: dict[str, Callable[[Array, Array], Array]] = {
    "quadratic": lambda up, share: up**2,
    "product_across": lambda up, share: up[:, [1, 2, 0]] * up[:, [2, 0, 1]],
    "bias_drift": lambda up, share: np.broadcast_to(share, up.shape),
}
SIZE = 2e-3  # g, rms over the axes


def bent(effect: str, seed: int) -> dict[str, object]:
    """An accelerometer with an effect."""
    rng, made = np.random.default_rng(seed + 7), world(seed, 20)
    way, log = rng.normal(size=3), made.log
    share = (log.t / log.t[-1])[:, None]
    more = OF_FORCE[effect](log.up, share) * SIZE * way / np.sqrt(np.mean(way**2))
    return _judged(effect, World(made.chip, replace(log, force=log.force + more)))


def planted(effect: str, seed: int) -> dict[str, object]:
    rng = np.random.default_rng(seed + 7)
    way = rng.normal(size=(3, 3) if effect == "gyro_g_sensitivity" else 3)
    size = 0.05 * DEG if effect == "gyro_g_sensitivity" else 0.005
    more = size * way / np.sqrt(np.mean(way**2))
    name = "by_force" if effect == "gyro_g_sensitivity" else "asymmetry"
    return _judged(effect, world(seed, 20, **{name: more}))


def _judged(effect: str, made: World) -> dict[str, object]:
    content = report(made.log)
    found = told(content)
    places = [(s["effect"], *s["aliases"]) for s in content["loop"]["steps"]]
    held = content["loop"]["errors"][0]["held_out"]
    return {
        "named": any(effect in place for place in places), "first": found[:1], "told": found,
        "final": held["final"], "plain": held_out(made.log), "z": off(content, made.chip),
    }  # fmt: skip


def _wrong(seed: int) -> tuple[Log, Log]:
    """A log, and the same with its gyroscope in wrong axes or in deg/s."""
    rng, made = np.random.default_rng(seed + 3), world(seed)
    log = made.log
    if seed % 5 == 0:
        return log, replace(log, rate=log.rate / DEG)
    axes = np.eye(3)
    while np.array_equal(axes, np.eye(3)):
        axes = np.eye(3)[rng.permutation(3)] * rng.choice([1.0, -1.0], 3)[:, None]
    return log, replace(log, rate=log.rate @ axes)


def undone(seed: int) -> dict[str, object]:
    """Whether the line that is printed gives what the right file gives."""
    log, wrong = _wrong(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = written(wrong, Path(folder) / "log.h5")
        refused = str(command(path, "--no-loop").exception)
        line = re.findall(r"--gyro-axes=[-xyz,]*[xyz]|--gyro-unit deg/s", refused)
        if not line:
            return {"named": False, "undone": False}
        again = command(path, "--no-loop", *line[0].split())
    if again.exception is not None:
        return {"named": True, "undone": False}
    values = [
        np.array([p["value"] for p in c["parameters"] if p["name"].startswith("gyro_gain")])
        for c in (json.loads(again.stdout), report(log, "--no-loop"))
    ]
    return {"named": True, "undone": bool(np.allclose(*values, atol=1e-4))}


def _norms(force: Array) -> Array:
    """(N, 3) forces by the accelerometer whose readings' sizes are nearest to one."""

    def corrected(x: Array) -> Array:
        lower = np.eye(3)
        lower[np.tril_indices(3)] += x[3:]
        return np.asarray((force - x[:3]) @ lower.T)

    found = least_squares(lambda x: np.linalg.norm(corrected(x), axis=1) - 1.0, np.zeros(9))
    return corrected(found.x)


def _product(vectors: Array) -> Rotation:
    """Of small rotations (n, 3) rad, one after the other."""
    while len(vectors) > 1:
        if len(vectors) % 2:
            vectors = np.vstack([vectors, np.zeros(3)])
        each = Rotation.from_rotvec(vectors)
        vectors = (each[::2] * each[1::2]).as_rotvec()
    return Rotation.from_rotvec(vectors[0])


def held_out(log: Log) -> float:
    """deg rms of plain least squares over turns that took no part, blocks of them in turn."""
    force, bias, turns = [], [], []
    for a, b in log.still:
        force.append(log.force[(log.t > a + 0.1) & (log.t < b - 0.1)].mean(axis=0))
        bias.append(log.rate[(log.t_gyro > a + 0.1) & (log.t_gyro < b - 0.1)].mean(axis=0))
    for k, (a, b) in enumerate(zip(log.still[:-1, 1], log.still[1:, 0], strict=True)):
        at = (log.t_gyro > a - 0.1) & (log.t_gyro < b + 0.1)
        w = log.rate[at] - 0.5 * (bias[k] + bias[k + 1])
        turns.append(0.5 * (w[1:] + w[:-1]) * np.diff(log.t_gyro[at])[:, None])
    up = _norms(np.array(force))
    up /= np.linalg.norm(up, axis=1)[:, None]

    def misses(x: Array, which: Array) -> Array:
        found = []
        for k in which:
            whole = _product(turns[k] @ (np.eye(3) + x.reshape(3, 3)).T)
            found.append(whole.inv().apply(up[k]) - up[k + 1])
        return np.concatenate(found)

    count = np.arange(len(turns))
    part, found = count * FOLDS // len(turns), np.zeros(len(turns))
    for fold in range(FOLDS):
        best = least_squares(misses, np.zeros(9), args=(count[part != fold],), max_nfev=8)
        own = count[part == fold]
        found[own] = np.linalg.norm(misses(best.x, own).reshape(-1, 3), axis=1) / DEG
    return float(np.sqrt(np.mean(found**2)))


def _tried(job: Job, *given: object) -> dict[str, object]:
    try:
        return job(*given)
    except ImucalError as error:
        return {"refused": str(error)}


def _share(flags: list[bool]) -> str:
    return f"{sum(flags)} of {len(flags)} ({100 * np.mean(flags):.0f} %)"


def _beside(found: list[dict]) -> str:  # type: ignore[type-arg]
    ratio = np.array([f["final"] / f["plain"] for f in found])
    return (
        f"held out over plain least squares' {np.exp(np.mean(np.log(ratio))):.2f} in the mean, "
        f"{ratio.max():.2f} at worst"
    )


def _intervals(found: list[dict], gyro: bool) -> str:  # type: ignore[type-arg]
    z = np.array([v for f in found for n, v in f["z"].items() if n.startswith("gyro") == gyro])
    return f"{100 * np.mean(np.abs(z) < 1.96):.1f} % of {z.size} intervals hold (z {z.std():.2f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--logs", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    seeds = range(1000 * given.seed, 1000 * given.seed + given.logs)
    with ProcessPoolExecutor(given.jobs) as pool:

        def each(job: Job, *more: str) -> list[dict]:  # type: ignore[type-arg]
            found = pool.map(_tried, [job] * len(seeds), *([w] * len(seeds) for w in more), seeds)
            return [f for f in found if "refused" not in f or print("refused:", f["refused"])]

        found = each(clean)
        print(f"clean, gains: {_intervals(found, True)}; accelerometer: {_intervals(found, False)}")
        for low, high in ((10, 14), (15, 19), (20, 24)):
            some = [f for f in found if low <= f["rests"] <= high]
            print(f"  {low}-{high} rests, gains: {_intervals(some, True)}")
        claims = [f["told"] for f in found if f["told"]]
        print(f"  claims: {_share([bool(f['told']) for f in found])} {claims}; {_beside(found)}")
        for effect in ("gyro_g_sensitivity", "gyro_asymmetry", *OF_FORCE):
            found = each(bent if effect in OF_FORCE else planted, effect)
            print(f"{effect}: named {_share([f['named'] for f in found])}; gains: "
                  f"{_intervals(found, True)}; {_beside(found)}")  # fmt: skip
            print("  others:", [f["told"] for f in found if f["first"] != [(effect, True)]])
        found = each(undone)
        print(f"wrong axes or unit: named {_share([f['named'] for f in found])}, "
              f"undone {_share([f['undone'] for f in found])}")  # fmt: skip


if __name__ == "__main__":
    main()
