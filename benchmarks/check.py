"""The marks of `imucal check`: false alarms, shifts that are found, the power that is stated
against the power had, and evidence under repeated looks.

Sensors, calibrations and checks are made in plain numpy; the program calibrates and checks. Usage:

    python benchmarks/check.py [--runs 400] [--jobs 1]
"""

from __future__ import annotations

import argparse
import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray

from imucalib.calibration.calibration import Calibration, from_fit
from imucalib.calibration.checking.check import look_of
from imucalib.calibration.checking.e_value import e_value
from imucalib.calibration.checking.misfit import misfits_of
from imucalib.calibration.checking.noise import check_noise
from imucalib.calibration.checking.statistic import Statistic
from imucalib.calibrators.lab.bench import position_observations, still_observations
from imucalib.calibrators.lab.calibrate import LabSettings, base_model
from imucalib.calibrators.lab.calibration import noise_block
from imucalib.calibrators.lab.conventions import Conventions
from imucalib.calibrators.lab.position_table import PositionTable
from imucalib.core.observations import Observations
from imucalib.estimators.least_squares import fit

Array = NDArray[np.float64]
G = 9.80665  # m/s²
MG, DEG = G * 1e-3, np.pi / 180.0
ALPHA = 0.05


@dataclass(frozen=True)
class World:
    """known : positions with angles, else rests in unknown attitudes; noise mg, setting deg;
    rests of the calibration and of the check"""

    known: bool
    noise: float
    setting: float
    calibrated: int
    checked: int


WORLDS = {
    "rests": World(False, 0.25, 0.0, 24, 4),
    "rests, 0.4 mg": World(False, 0.40, 0.0, 24, 4),
    "positions": World(True, 0.25, 0.01, 32, 4),
    "positions, few": World(True, 0.25, 0.01, 12, 4),
}


class Sensor:
    """reading = b + (I + S + K) x + noise, x = Rz Ry Rx f."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.bias = 20.0 * MG * rng.standard_normal(3)
        self.gain = np.eye(3) + np.diag(0.006 * rng.standard_normal(3))
        self.gain[1, 0], self.gain[2, 0], self.gain[2, 1] = 0.005 * rng.standard_normal(3)
        self.turn = rotation(1.5 * rng.standard_normal(3))

    def read(self, force: Array, noise: float, rng: np.random.Generator) -> Array:
        """(n, 3) m/s² of specific force (n, 3) in the tool's frame."""
        clean = force @ self.turn.T @ self.gain.T + self.bias
        return clean + noise * MG * rng.standard_normal(force.shape)


def rotation(angles: Array) -> Array:
    """Rz Ry Rx of angles in deg."""
    out = np.eye(3)
    for axis, angle in enumerate(angles * DEG):
        c, s = np.cos(angle), np.sin(angle)
        own = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        own[i, i], own[j, j], own[i, j], own[j, i] = c, c, -s, s
        out = own @ out
    return out


def positions(n: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Inclination and tool-face (deg), even over the sphere, in random order."""
    share = (np.arange(n) + 0.5) / n
    inclination = np.degrees(np.arcsin(0.97 * (2.0 * rng.permutation(share) - 1.0)))
    return inclination, 360.0 * ((np.arange(n) * 0.618034 + rng.random()) % 1.0)


def four(rng: np.random.Generator) -> tuple[Array, Array]:
    """A tetrahedron, turned at random: what a careful hand does."""
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    u = corners @ (q * np.sign(np.diag(r))).T
    return np.degrees(np.arcsin(u[:, 2])), np.degrees(np.arctan2(u[:, 0], u[:, 1]))


def vectors(inclination: Array, tool_face: Array) -> Array:
    i, t = inclination * DEG, tool_face * DEG
    return G * np.stack([np.cos(i) * np.sin(t), np.cos(i) * np.cos(t), np.sin(i)], axis=-1)


def recorded(
    world: World, sensor: Sensor, angles: tuple[Array, Array], rng: np.random.Generator
) -> Observations:
    """What is read in some attitudes, as the program gets it."""
    inclination, tool_face = angles
    off = world.setting * rng.standard_normal((2, inclination.size))
    reading = sensor.read(vectors(inclination + off[0], tool_face + off[1]), world.noise, rng)
    columns = {"inclination": inclination, "tool_face": tool_face}
    row = np.arange(inclination.size)
    table = PositionTable(columns, {}, {}, row, "", "")
    if world.known:
        return position_observations(table, reading, Conventions(), G, sigma=1.0)
    return still_observations(table, reading, G, sigma=1.0)


def calibrated(world: World, sensor: Sensor, rng: np.random.Generator) -> Calibration:
    """By the program, without its search."""
    data = recorded(world, sensor, positions(world.calibrated, rng), rng)
    made = fit(base_model(LabSettings(), data), data)
    facts = {"noise": noise_block(made)}
    return from_fit(
        made, "lab", raw_unit="m/s2", raw_to_si=1.0, gravity=G, status="ok", reasons=(), facts=facts
    )


def changed(sensor: Sensor, kind: str, size: float, along: Array) -> Sensor:
    """The same sensor after a shift: mg of bias or deg of mounting along a direction."""
    other = object.__new__(Sensor)
    other.bias, other.gain, other.turn = sensor.bias, sensor.gain, sensor.turn
    if kind == "bias":
        other.bias = sensor.bias + size * MG * along
    elif kind == "mounting":
        angle = size * DEG
        k = np.array([[0, -along[2], along[1]], [along[2], 0, -along[0]], [-along[1], along[0], 0]])
        turn = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k
        other.turn = turn @ sensor.turn
    return other


@dataclass(frozen=True)
class Trial:
    """p by kind of shift; stated : shift that the check says it could see; e : by kind"""

    p: dict[str, float]
    e: dict[str, float]
    stated: dict[str, float]


def trial(job: tuple[str, int]) -> Trial:
    """One device: calibrated, then checked unchanged and after every shift."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, len(name)])
    sensor = Sensor(rng)
    made = calibrated(world, sensor, rng)
    noise = check_noise(made)
    angles = four(rng) if world.checked == 4 else positions(world.checked, rng)
    along = rng.standard_normal(3)
    along /= np.linalg.norm(along)
    shifts = {"none": ("bias", 0.0, along), "bias 1.5 mg": ("bias", 1.5, along)}
    if world.known:
        shifts["mounting 0.1 deg"] = ("mounting", 0.1, along)
    first = Statistic(misfits_of(made, recorded(world, sensor, angles, rng), noise)[0], seed=seed)
    stated = {}
    for kind in first.columns:
        worst = first.worst(kind)
        stated[kind] = first.seen(kind)
        if kind != "scale" and worst is not None:
            shifts[f"stated {kind}"] = (kind, stated[kind], worst * rng.choice([-1.0, 1.0]))
    p, e = {}, {}
    for what, (kind, size, direction) in shifts.items():
        now = recorded(world, changed(sensor, kind, size, direction), angles, rng)
        misfits, _ = misfits_of(made, now, noise)
        p[what] = Statistic(misfits, seed=seed).p()
        e[what] = e_value(
            [look_of(misfits, p[what])], misfits.parameters, reading=noise.reading.sd,
            dof=misfits.dof, gravity=G,
        )  # fmt: skip
    return Trial(p, e, stated)


def repeated(job: tuple[str, int]) -> tuple[float, float]:
    """Twenty checks of an unchanged sensor with one calibration: largest e, smallest p."""
    name, seed = job
    world = WORLDS[name]
    rng = np.random.default_rng([seed, 77])
    sensor = Sensor(rng)
    made = calibrated(world, sensor, rng)
    noise = check_noise(made)
    looks, largest = [], 0.0
    for _ in range(20):
        misfits, _ = misfits_of(made, recorded(world, sensor, four(rng), rng), noise)
        looks.append(look_of(misfits, Statistic(misfits, seed=seed, draws=2000).p()))
        largest = max(largest, e_value(looks, misfits.parameters, reading=noise.reading.sd,
                                       dof=misfits.dof, gravity=G))  # fmt: skip
    return largest, min(look.p for look in looks)


def share(hits: list[bool]) -> str:
    return f"{100.0 * np.mean(hits):.1f} %"


def main() -> None:
    """Print Markdown tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=400)
    parser.add_argument("--jobs", type=int, default=1)
    chosen = parser.parse_args()
    print("| world | shift | found (p <= 5 %) | found (e >= 20) | stated, median |")
    print("|---|---|---|---|---|")
    with ProcessPoolExecutor(chosen.jobs) as pool:
        for name, world in WORLDS.items():
            trials = list(pool.map(trial, [(name, k) for k in range(chosen.runs)], chunksize=8))
            for what in trials[0].p:
                kind = what.removeprefix("stated ")
                size = [t.stated[kind] for t in trials] if what.startswith("stated") else []
                print(f"| {name}: {world.noise:g} mg, {world.setting:g} deg, "
                      f"{world.calibrated} + {world.checked} | {what} "
                      f"| {share([t.p[what] <= ALPHA for t in trials])} "
                      f"| {share([t.e[what] >= 1 / ALPHA for t in trials])} "
                      f"| {f'{np.median(size):.2f}' if size else '-'} |", flush=True)  # fmt: skip
        both = list(pool.map(repeated, [("rests", k) for k in range(chosen.runs)], chunksize=8))
    print(f"\n20 checks of one calibration, nothing changed, {chosen.runs} devices: e >= 20 ever "
          f"in {share([e >= 20 for e, _ in both])}, p <= 5 % ever in "
          f"{share([p <= ALPHA for _, p in both])}")  # fmt: skip


if __name__ == "__main__":
    main()
