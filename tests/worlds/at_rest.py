"""A sensor at rest in attitudes at random, in plain numpy, observed by the size of gravity."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Context
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.units import MG, STANDARD_GRAVITY

HOUR = 3600.0
SPAN = 48.0 * HOUR


def attitudes(rng: np.random.Generator, n: int) -> Array:
    """(n, 3) of length one, even over the sphere."""
    u = rng.normal(size=(n, 3))
    return np.asarray(u / np.linalg.norm(u, axis=1, keepdims=True))


def at_rest(seed: int, n: int, bend: float = 0.0, noise: float = 0.3) -> Observations:
    """Rows one after the other; bend : mg/g² along each axis; noise : mg."""
    rng = np.random.default_rng(seed)
    u = attitudes(rng, n)
    gain = np.eye(3) + np.triu(0.003 * rng.normal(size=(3, 3))) + 0.004 * np.diag([1.0, -1.0, 0.5])
    reading = 1000.0 * u @ gain.T + [12.0, -9.0, 20.0] + bend * np.array([1.0, -0.8, 1.2]) * u**2
    reading = reading + noise * rng.normal(size=(n, 3))
    return observed(reading, {"order": np.linspace(0.0, 1.0, n)}, np.arange(n), "row")


def worn(seed: int, n: int = 90, drift: float = 0.0, hours: float = 8.0) -> Observations:
    """Postures of two days in plain numpy, 0.3 mg; drift : mg, of the bias."""
    rng = np.random.default_rng(seed)
    time = np.sort(rng.uniform(0.0, SPAN, n))
    u = attitudes(rng, n)
    off = drift * rng.normal(size=(n, 3))
    for k in range(1, n):
        keep = np.exp((time[k - 1] - time[k]) / (hours * HOUR))
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * off[k]
    gain = np.eye(3) + np.diag([0.004, -0.003, 0.002])
    reading = 1000.0 * u @ gain.T + [12.0, -9.0, 20.0] + off + 0.3 * rng.normal(size=(n, 3))
    group = np.minimum((time / SPAN * 12).astype(int), 11)
    return observed(reading, {"time": time, "order": time / SPAN}, group, "run")


def observed(reading: Array, known: dict[str, Array], group: Index, name: str) -> Observations:
    """Of readings (n, 3) mg."""
    n = len(reading)
    return Observations(
        reading[:, None] * MG,
        np.full((n, 1, 3), MG),
        KnownNorm(n, STANDARD_GRAVITY),
        Context(n, {**known, "record": np.arange(n, dtype=float)}),
        group,
        tuple(f"{name} {k + 1}" for k in range(n)),
    )
