"""Files as other libraries write them, with planted truth: what is in each, and its writer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imucalib.arrays import Array
from imucalib.recording.mapping import FieldMapping

N, RATE, START = 640, 100.0, 1_700_000_000
G, DEG = 9.80665, np.pi / 180.0


def truth() -> tuple[Array, Array, Array]:
    """s, m/s² and rad/s of a sensor that rests in eight attitudes and turns between them."""
    rng = np.random.default_rng(11)
    ups = np.array([[x, y, z] for x in (-1, 1) for y in (-0.5, 0.6) for z in (-0.8, 0.7)])
    ups /= np.linalg.norm(ups, axis=1)[:, None]
    acc = np.repeat(G * ups, N // 8, axis=0) + rng.normal(scale=0.01, size=(N, 3))
    rate = rng.normal(scale=0.002, size=(N, 3)) + np.array([0.01, -0.02, 0.03])
    turning = np.arange(N) % (N // 8) < 15
    rate[turning] += rng.normal(scale=0.5, size=(int(turning.sum()), 3))
    return np.arange(N) / RATE, np.round(acc, 5), np.round(rate, 6)


T, ACC, RATES = truth()
TEMPERATURE = np.round(25.0 + 0.001 * np.arange(N), 3)


@dataclass(frozen=True)
class Dialect:
    """One file.

    write : into a folder; returns its path
    expected : "right"; "told", where what is not in the file is named (a unit); or "refused"
    force, turn : what is planted, by the sensor's name; None of an angular rate that is not read
    resolution : of the numbers, SI; kept : rows that have a value; dated : whether stamps are dates
    """

    package: str
    write: Callable[[Path], Path]
    expected: str = "right"
    mapping: FieldMapping = field(default_factory=FieldMapping)
    force: Mapping[str, Array] = field(default_factory=lambda: {"imu0": ACC})
    turn: Mapping[str, Array] = field(default_factory=lambda: {"imu0": RATES})
    resolution: float = 1e-9
    kept: Array | None = None
    dated: bool | None = None


DIALECTS: dict[str, Dialect] = {}


def dialect(package: str, **facts: object) -> Callable[[Callable[[Path], Path]], None]:
    """Register what writes one file."""

    def add(write: Callable[[Path], Path]) -> None:
        DIALECTS[f"{package}_{write.__name__}"] = Dialect(package, write, **facts)  # type: ignore[arg-type]

    return add
