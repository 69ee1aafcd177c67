"""What any check of few rests could find at best, beside the test of `imucal check`: plain numpy.

    python benchmarks/check_bound.py [--shift 1.5] [--noise 0.4]

A sensor is calibrated from 24 rests by the size of gravity (nine parameters, 15 degrees of freedom
left); its bias then shifts in a random direction. A rest sees the shift along gravity, beside its
own noise and the calibration's error: λ² = bᵀ Uᵀ V⁻¹ U b. At 5 % false alarms

    direction  the likelihood ratio of a shift whose direction and size, and the noise, are known:
               no test finds more (Neyman and Pearson)
    bias       noncentral χ²(3): the noise known, and that it is the bias
    noise      noncentral F(3, 15): the noise from the calibration
    kinds      the same, bias or scale or anything, by the smallest p: the test of `check`
"""

from __future__ import annotations

import argparse

import numpy as np
from scipy import stats

ALPHA, CALIBRATED, DRAWS, TURNS = 0.05, 24, 20000, 200
RESTS = (4, 5, 6, 8, 10, 12)


def spread(count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) over the sphere, turned at random; four are a tetrahedron."""
    if count == 4:
        u = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / np.sqrt(3.0)
    else:
        z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
        turn = np.pi * (1.0 + 5.0**0.5) * np.arange(count)
        u = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    return u @ np.linalg.qr(rng.standard_normal((3, 3)))[0].T


def columns(u: np.ndarray) -> np.ndarray:
    """(n, 9) of the size of gravity: bias, scale, cross terms."""
    return np.column_stack([u, u**2, u[:, :1] * u[:, 1:], u[:, 1] * u[:, 2]])


def basis(white: np.ndarray) -> np.ndarray:
    u, s, _ = np.linalg.svd(white, full_matrices=False)
    return u[:, s > 1e-9 * s[0]]


def least(z: np.ndarray, bases: list[np.ndarray], scale: np.ndarray, dof: int) -> np.ndarray:
    """(draws,) the smallest p of all kinds; z (draws, n), scale (draws,) estimated over true."""
    found = np.ones(len(z))
    for own in bases:
        f = np.sum((z @ own) ** 2, axis=1) / own.shape[1] / scale
        found = np.minimum(found, stats.f.sf(f, own.shape[1], dof))
    return found


def power(count: int, shift: float, noise: float, rng: np.random.Generator) -> np.ndarray:
    """Shares found by the four tests, over random turns and directions; and λ."""
    dof, told = CALIBRATED - 9, []
    bar = stats.chi2.isf(ALPHA, 3)
    for _ in range(TURNS):
        known = columns(spread(CALIBRATED, rng))
        u = spread(count, rng)
        own = columns(u)
        whole = np.eye(count) + own @ np.linalg.solve(known.T @ known, own.T)
        root = np.linalg.inv(np.linalg.cholesky(whole * noise**2))
        along = rng.standard_normal(3)
        moved = root @ u @ (shift * along / np.linalg.norm(along))
        square = float(moved @ moved)
        bases = [basis(root @ u), basis(root @ u**2), np.eye(count)]
        z = rng.standard_normal((DRAWS // TURNS, count))
        scale = rng.chisquare(dof, len(z)) / dof
        level = np.quantile(least(rng.standard_normal(
            (4000, count)), bases, rng.chisquare(dof, 4000) / dof, dof), ALPHA)  # fmt: skip
        told.append([
            stats.norm.cdf(np.sqrt(square) - stats.norm.isf(ALPHA)),
            stats.ncx2.sf(bar, 3, square),
            stats.ncf.sf(stats.f.isf(ALPHA, 3, dof), 3, dof, square),
            np.mean(least(z + moved, bases, scale, dof) <= level),
            np.sqrt(square),
        ])  # fmt: skip
    return np.mean(told, axis=0)


def main() -> None:
    """A line for each number of rests."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shift", type=float, default=1.5)
    parser.add_argument("--noise", type=float, default=0.4)
    asked = parser.parse_args()
    print("| rests | λ, mean | direction known | bias, noise known | noise estimated | any kind |")
    print("|---|---|---|---|---|---|")
    rng = np.random.default_rng(0)
    for count in RESTS:
        *found, size = power(count, asked.shift, asked.noise, rng)
        cells = " | ".join(f"{100.0 * v:.0f} %" for v in found)
        print(f"| {count} | {size:.1f} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
