"""Small arrays for tests: geometry, motion and readings straight from the measurement model."""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array
from imucalib.estimators.array.published import ArrayData
from imucalib.units import DEG


def skew(v: Array) -> Array:
    """(…, 3, 3) with skew(v) @ r = v × r."""
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    return np.asarray(out - np.swapaxes(out, -1, -2))


def corners(triads: int = 8) -> Array:
    """(A, 3) m: corners of a box 18.9 x 18.9 x 2 mm, first at the origin."""
    x, z = 9.45e-3, 1e-3
    box = np.array([(i, j, k) for i in (-x, x) for j in (-x, x) for k in (z, -z)])[:triads]
    return box - box[0]


def data_of(
    r: Array, samples: int, rng: np.random.Generator, *, sigma: float = 0.04,
    sigma_gyro: float = 0.06, rate: float = 1000.0, spin: float = 35000.0,
) -> tuple[ArrayData, Array]:  # fmt: skip
    """Readings of twisting motion (deg/s, deg/s²), and the true rate (T, 3) rad/s."""
    w = rng.normal(size=(samples, 3)) * rate * DEG
    spins = rng.normal(size=(samples, 3)) * spin * DEG
    s = rng.normal(size=(samples, 3)) * 20.0
    turn = skew(w) @ skew(w) + skew(spins)
    y = np.einsum("tij,aj->tai", turn, r) + s[:, None]
    y += rng.normal(size=y.shape) * sigma
    sd = sigma_gyro * DEG / np.sqrt(len(r))
    precision = np.eye(3) / sd**2 * rng.uniform(0.8, 1.2, size=samples)[:, None, None]
    measured = w + rng.normal(size=w.shape) * sd
    return ArrayData(y, np.full(len(r), sigma), measured, precision), w
