"""Independent moving samples of an array, as section IV-A of paper 001 has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.simulation import lever_arm
from imucalib.estimators.array.problem import ArrayData
from imucalib.units import DEG


@dataclass(frozen=True)
class MotionPlan:
    """The paper's figures are the defaults.

    rate, spin : deg/s and deg/s², sd of each axis of ω and ω̇; force : m/s², sd of s
    sigma, sigma_gyro : m/s² and deg/s, of one triad's axis
    """

    samples: int = 50
    rate: float = 1000.0
    spin: float = 35_000.0
    force: float = 20.0
    sigma: float = 0.04
    sigma_gyro: float = 0.06


def simulated_samples(r: Array, plan: MotionPlan, rng: np.random.Generator) -> ArrayData:
    """Calibrated readings of positions r (A, 3) m in random motion."""
    t, a = plan.samples, len(r)
    w, spin = (rng.normal(size=(t, 3)) * sd * DEG for sd in (plan.rate, plan.spin))
    y = lever_arm(w, spin, r) + rng.normal(size=(t, 1, 3)) * plan.force
    sd = plan.sigma_gyro * DEG / np.sqrt(a)
    return ArrayData(
        y + rng.normal(size=y.shape) * plan.sigma,
        np.full(a, plan.sigma),
        w + rng.normal(size=w.shape) * sd,
        np.eye(3) / sd**2,
    )
