"""Errors against the Cramér-Rao bound in the cases of paper 002, section III.A.

python benchmarks/actigraph/bounds.py [--cases 500]
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.actigraph.published import PointCollector
from imucalib.core.balance import Noise
from imucalib.core.effect import Context
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.core.references import KnownNorm
from imucalib.effects import named
from imucalib.estimators.gradient_descent import descend
from imucalib.estimators.least_squares import fit
from imucalib.units import MG, STANDARD_GRAVITY

Array = NDArray[np.float64]
G = STANDARD_GRAVITY


def case(rng: np.random.Generator, windows: int, noise: float) -> tuple[Array, Array]:
    """The true p and points (n, 3) in g: 18 by the nine-bin rule where `windows` is 18."""
    s = 1.0 + rng.uniform(-0.1, 0.1, 3)
    t, o = rng.uniform(-0.05, 0.05, 3), rng.uniform(-0.1, 0.1, 3)
    p = np.concatenate([s, [s[1] * t[0], s[2] * t[1], s[2] * t[2]], o])
    gain = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    collector, points = PointCollector(), []
    while len(points) < windows:
        truth = rng.standard_normal(3)
        point = np.linalg.solve(gain, truth / np.linalg.norm(truth)) - o
        point = point + noise * 1e-3 * rng.standard_normal(3)
        if windows != 18 or collector.offer(point):
            points.append(point)
    return p, np.array(points)


def solved(points: Array, p: Array, noise: float) -> tuple[Array, Array, Array]:
    """Errors of p by least squares, and its bound at the true p."""
    n = len(points)
    data = Observations(
        G * points[:, None], np.full((n, 1, 3), noise * MG), KnownNorm(n, G), Context(n),
        np.arange(n), tuple(map(str, range(n))),
    )  # fmt: skip
    model = Model(tuple(named(e) for e in ("bias", "scale", "non_orthogonality")))
    found = fit(model, data, noise=Noise(1.0))
    theta = found.theta
    lower = np.eye(3) + np.diag(theta[3:6])
    lower[[1, 2, 2], [0, 0, 1]] = theta[6:]
    gain = np.linalg.inv(lower)
    estimate = np.concatenate([np.diag(gain), gain[[1, 2, 2], [0, 0, 1]], -theta[:3] * MG / G])
    # Fisher information of |K (v + o)| at the truth; the norm's noise is |Kᵀ u| times the sensor's.
    k = np.array([[p[0], 0, 0], [p[3], p[1], 0], [p[4], p[5], p[2]]])
    v = points + p[6:]
    a = v @ k.T
    u = a / np.linalg.norm(a, axis=1, keepdims=True)
    slope = np.column_stack(
        [u[:, 0] * v[:, 0], u[:, 1] * v[:, 1], u[:, 2] * v[:, 2], u[:, 1] * v[:, 0],
         u[:, 2] * v[:, 0], u[:, 2] * v[:, 1], u @ k]
    ) / (np.linalg.norm(u @ k, axis=1)[:, None] * noise * 1e-3)  # fmt: skip
    bound = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    theta_true = np.concatenate(
        [-p[6:] * G / MG, np.diag(np.linalg.inv(k)) - 1.0, np.linalg.inv(k)[[1, 2, 2], [0, 0, 1]]]
    )
    return estimate - p, bound, (theta - theta_true) / found.sd


def main() -> None:
    """Print mean absolute errors by group, their bound, and the spread of z."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500)
    cases = parser.parse_args().cases
    print("noise  points  group     |error|   bound     rms/bound  gradient descent   z sd")
    for noise in (1.0, 5.0):
        for windows in (18, 400, 2000):
            rng = np.random.default_rng(int(noise) + windows)
            made = [case(rng, windows, noise) for _ in range(cases)]
            results = [solved(points, p, noise) for p, points in made]
            error, bound, z = (np.array(x) for x in zip(*results, strict=True))
            paper = np.array(
                [descend(points) - p for p, points in made]
                if windows == 18
                else [np.full(9, np.nan)]
            )
            for name, part in (
                ("diag", slice(3)),
                ("off-diag", slice(3, 6)),
                ("offset", slice(6, 9)),
            ):
                rms = np.sqrt(np.mean(error[:, part] ** 2) / np.mean(bound[:, part] ** 2))
                mean_bound = bound[:, part].mean() * np.sqrt(2.0 / np.pi)
                print(
                    f"{noise:4.0f}  {windows:6d}  {name:9s} {np.abs(error[:, part]).mean():.2e}  "
                    f"{mean_bound:.2e}  {rms:9.3f}  {np.abs(paper[:, part]).mean():16.2e}  "
                    f"{z.std():6.3f}"
                )


if __name__ == "__main__":
    main()
