"""Marks of the detector of rests, on made logs and on a measured one.

    python benchmarks/rests [--logs 40] [--xsens FOLDER]

The worlds know nothing of the detector: attitudes are turned by hand-like rates that begin and end
smoothly, the hand trembles while it moves, and the chips' noise, rate and gyroscope vary.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from imucalib.readers import read
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments, still_segments

G = 9.80665
MG = 1e-3 * G


@dataclass(frozen=True)
class Log:
    recording: Recording
    stretches: list[tuple[float, float]]  # s, what was planted


@dataclass(frozen=True)
class Chip:
    rate: float  # Hz
    noise: float  # m/s²
    gyroscope: bool


def chip(rng: np.random.Generator) -> Chip:
    noise = MG * float(np.exp(rng.uniform(np.log(0.3), np.log(6.0))))
    return Chip(float(rng.choice([50.0, 100.0, 200.0])), noise, bool(rng.random() < 0.5))


def hand(rng: np.random.Generator, rate: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Angular rate (rad/s) and linear acceleration (m/s²) of a move with smooth ends."""
    n = max(4, round(seconds * rate))
    bell = np.sin(np.pi * (np.arange(n) + 0.5) / n) ** 2
    turn = np.radians(rng.uniform(40.0, 140.0)) / seconds * 2.0 * bell
    axis = rng.normal(size=3)
    spin = turn[:, None] * axis / np.linalg.norm(axis)
    tremble = gaussian_filter1d(rng.normal(size=(n, 3)), 0.02 * rate, axis=0)
    tremble *= rng.uniform(0.3, 1.5) / tremble.std()
    return spin, tremble * np.sqrt(bell)[:, None]


def recorded(
    spin: np.ndarray, force: np.ndarray, c: Chip, rng: np.random.Generator, sd: float | np.ndarray
) -> Recording:
    """What a chip reads of an angular rate and a linear acceleration, from a random attitude."""
    steps = Rotation.from_rotvec(-spin / c.rate)
    down = Rotation.random(random_state=rng).as_matrix()[2]
    matrices, gravity = steps.as_matrix(), np.empty_like(spin)
    for i, matrix in enumerate(matrices):
        down = matrix @ down
        gravity[i] = down
    bias = rng.normal(0, 20 * MG, 3)
    values = G * gravity + force + bias + rng.normal(size=spin.shape) * sd
    t = np.arange(len(spin)) / c.rate
    channels = {"imu0/acceleration": Channel(t, values, "m/s2", "acceleration", "imu0", c.rate)}
    if c.gyroscope:
        rate = spin + np.radians(rng.normal(0, 0.5, 3) + rng.normal(0, 0.07, spin.shape))
        key = "imu0/angular_rate"
        channels[key] = Channel(t, rate, "rad/s", "angular_rate", "imu0", c.rate)
    return Recording(channels, "made", "made", "")


def bench(rng: np.random.Generator, lengths: np.ndarray, per_minute: float) -> Log:
    """Rests of given lengths (s) between moves."""
    c, parts, spans, at = chip(rng), [], [], 0
    for length in lengths:
        pause = max(0.6, 60.0 / per_minute - length) * rng.uniform(0.7, 1.3)
        whole = []
        while pause > 0.3:  # several moves, without a stop between them
            one = min(pause, rng.uniform(0.6, 1.5))
            whole.append(hand(rng, c.rate, one))
            pause -= one
        n = round(length * c.rate)
        parts += [*whole, (np.zeros((n, 3)), np.zeros((n, 3)))]
        at += sum(len(spin) for spin, _ in whole)
        spans.append((at / c.rate, (at + n - 1) / c.rate))
        at += n
    parts.append(hand(rng, c.rate, 1.0))
    spin, force = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
    return Log(recorded(spin, force, c, rng, c.noise), spans)


def slow(rng: np.random.Generator, kind: str) -> Log:
    """A bench log in whose middle something slow goes on: a turn, a creep, or a hand that holds."""
    c, seconds = chip(rng), rng.uniform(10.0, 60.0)
    n, rest = round(seconds * c.rate), round(5.0 * c.rate)
    still = (np.zeros((rest, 3)), np.zeros((rest, 3)))
    around = [part for _ in range(4) for part in (still, hand(rng, c.rate, 1.2))]
    spin, force = np.zeros((n, 3)), np.zeros((n, 3))
    parts = [*around, (spin, force), hand(rng, c.rate, 1.2), *around]
    before = sum(len(part[0]) for part in around)
    made = recorded(*(np.concatenate([p[k] for p in parts]) for k in (0, 1)), c, rng, c.noise)
    acceleration = made.channels["imu0/acceleration"]
    inside = slice(before, before + n)
    t = np.arange(n) / n
    gravity = acceleration.values[inside].mean(axis=0)
    across = np.cross(gravity, rng.normal(size=3))
    across /= np.linalg.norm(across)
    if kind == "turn":
        angle = np.radians(np.exp(rng.uniform(np.log(0.05), np.log(0.5)))) * seconds * t
        other = np.cross(across, gravity / np.linalg.norm(gravity))
        change = G * (np.sin(angle)[:, None] * other - (1 - np.cos(angle))[:, None] * gravity / G)
    elif kind == "creep":
        change = 30 * MG * (t if rng.random() < 0.5 else 1 - np.exp(-4 * t))[:, None] * across
    else:
        drift = gaussian_filter1d(rng.normal(size=(n, 3)), c.rate / rng.uniform(0.5, 3), axis=0)
        change = G * np.radians(rng.uniform(0.5, 2.0)) * drift / drift.std()
    acceleration.values[inside] += change
    return Log(made, [(before / c.rate, (before + n) / c.rate)])


def covered(found: Segments, a: float, b: float) -> float:
    """Seconds of an interval that are called rest."""
    shared = np.minimum(found.stop, b) - np.maximum(found.start, a)
    return float(np.maximum(shared, 0.0).sum())


def of_rests(logs: int) -> Iterator[str]:
    for low, high in ((1.0, 1.5), (1.5, 2.0), (2.0, 2.4), (2.4, 3.0)):
        rng = np.random.default_rng(round(10 * low))
        planted = hit = false = 0
        edges: list[float] = []
        for k in range(logs):
            per_minute = 2.0 if k % 4 == 0 else rng.uniform(2.0, 12.0)
            log = bench(rng, rng.uniform(low, high, 8), per_minute)
            found = still_segments(log.recording)
            middle = 0.5 * (found.start + found.stop)
            inside = np.zeros(found.n, dtype=bool)
            for a, b in log.stretches:
                planted += 1
                own = (middle > a) & (middle < b)
                inside |= own
                whole = covered(found, a, b) > 0.8 * (b - a)
                hit += bool(whole)
                edges += [*(a - found.start[own]), *(found.stop[own] - b)]
            false += int((~inside).sum())
        late = np.percentile(edges, [5, 50, 95, 100])
        yield (
            f"rests of {low}-{high} s: {hit} of {planted} found ({100 * hit / planted:.1f} %), "
            f"{false} false; ends beyond the truth by {late[0]:.2f} {late[1]:.2f} {late[2]:.2f} "
            f"(largest {late[3]:.2f}) s"
        )


def of_slow(logs: int) -> Iterator[str]:
    for kind in ("turn", "creep", "hand"):
        rng = np.random.default_rng(len(kind))
        refused = told = 0
        share = []
        for _ in range(4 * logs):
            log = slow(rng, kind)
            found = still_segments(log.recording)
            (a, b) = log.stretches[0]
            refused += covered(found, a, b) < 0.7
            share.append(covered(found, a, b) / (b - a))
            told += any(c.reason and c.start < b and c.stop > a for c in found.candidates)
        yield (
            f"{kind}: {refused} of {4 * logs} refused, {told} with a reason; "
            f"{100 * np.mean(share):.2f} % of the time called rest"
        )


def of_xsens(folder: Path) -> Iterator[str]:
    scale = tuple(G * lsb for lsb in (415, 413, 415))
    mapping = FieldMapping(
        acc=("2", "3", "4"), time="1", acc_unit="counts", lsb_per_g=scale,
        acc_offset=(33123, 33276, 32360),
    )  # fmt: skip
    recording = read(folder / "xsens_acc.txt", mapping)
    found = still_segments(recording)
    values, worst = recording.channels["imu0/acceleration"].values, 0.0
    for first, last in (ends for rest in found.spans for ends in rest[0]):
        rest, n = values[first:last], last - first
        middle = rest[n // 4 : n - n // 4]
        error = found.noise[0] / np.sqrt(30)
        for end in (rest[:30], rest[-30:]):
            worst = max(worst, float(np.max(np.abs(end.mean(0) - middle.mean(0)) / error)))
    seconds = found.stop - found.start
    yield (
        f"xsens_mti: {int((seconds >= 1.2).sum())} rests of 1.2 s and more, {seconds.sum():.0f} s; "
        f"largest z of an end {worst:.1f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=40, help="made logs a class")
    parser.add_argument("--xsens", type=Path, help="folder of xsens_acc.txt")
    asked = parser.parse_args()
    for line in (*of_rests(asked.logs), *of_slow(asked.logs)):
        print(line)
    for line in of_xsens(asked.xsens) if asked.xsens else ():
        print(line)


if __name__ == "__main__":
    main()
