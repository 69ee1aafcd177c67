"""Evidence against "nothing has changed" that stays valid however often one looks.

Over checks 1 … t of one calibration the misfits are stacked; its own error is common to all. A
change of a family that began with check τ adds κ² s² C Cᵀ to their covariance. Given the noise
estimate (ν degrees of freedom) both laws are multivariate t, whose ratio

    E = (|V₀| / |V₁|)^½ ((ν + eᵀV₀⁻¹e) / (ν + eᵀV₁⁻¹e))^((ν+N)/2)

is a test martingale for what is free of the scale: its mean is 1 at any stopping time (Pérez-Ortiz,
Lardy, de Heide and Grünwald 2024, Annals of Statistics 52, 1410-1432). `mixture` is its mean over
families, sizes κ and beginnings τ, weighted 1/(τ(τ+1)); what begins later counts 1.

At one look a fixed level has more power, so most of the stake goes on it: look j pays w_j / α_j
when its p is at most α_j = 0.7 α w_j, w = 0.7 for the first look and 0.3 / (j (j-1)) for others:
each payment has a mean of at most w_j, and sums need no independence (Vovk and Wang 2021, Annals of
Statistics 49, 1736-1754). By Ville's and Markov's inequalities E = 0.3 mixture + 0.7 payments ever
reaches 1/α with a chance of at most α.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.checking.noise import FAMILIES
from imucalib.units import DEG, MG

#: Sizes of a change, in noise of one reading, that the mixture holds.
KAPPA = (1.0, 2.0, 4.0, 8.0)
ALPHA = 0.05
#: Share of the stake on single looks, and of that on the first.
ON_LOOKS, ON_FIRST = 0.7, 0.7


@dataclass(frozen=True)
class Look:
    """One check, as its history keeps it.

    value : (N,) m/s²; noise : (N, N); jacobian : (N, p); changes : per family (N, 3), m/s² per unit
    p : of the check by itself
    """

    value: Array
    noise: Array
    jacobian: Array
    changes: Mapping[str, Array]
    p: float


def e_value(
    looks: Sequence[Look], parameters: Array, *, reading: float, dof: float, gravity: float
) -> float:
    """E after the last look. parameters : (p, p) covariance; reading : m/s², s; dof : ν"""
    mixed = mixture(looks, parameters, reading=reading, dof=dof, gravity=gravity)
    return (1.0 - ON_LOOKS) * mixed + ON_LOOKS * paid([look.p for look in looks])


def paid(p: Sequence[float], alpha: float = ALPHA) -> float:
    """What the looks at a fixed level have paid, each 1 / (0.7 α) where it reached its level."""
    j = np.arange(1, len(p) + 1)
    weight = np.where(j == 1, ON_FIRST, (1.0 - ON_FIRST) / np.maximum(j * (j - 1), 1))
    return float(np.sum(np.asarray(p) <= ON_LOOKS * alpha * weight)) / (ON_LOOKS * alpha)


def mixture(
    looks: Sequence[Look], parameters: Array, *, reading: float, dof: float, gravity: float
) -> float:
    """The martingale alone."""
    from scipy.linalg import solve_triangular

    value = np.concatenate([look.value for look in looks])
    jacobian = np.concatenate([look.jacobian for look in looks])
    plain = _block_diagonal([look.noise for look in looks]) + jacobian @ parameters @ jacobian.T
    root = np.linalg.cholesky(plain)
    white = solve_triangular(root, value, lower=True)
    number = np.repeat(np.arange(len(looks)), [look.value.size for look in looks])
    unit = {"bias": reading, "scale": reading / gravity, "mounting": reading / gravity}
    names = [name for name in FAMILIES if all(name in look.changes for look in looks)]
    total = 1.0 / (len(looks) + 1)  # changes that have not begun yet
    for start in range(len(looks)):
        weight = 1.0 / ((start + 1) * (start + 2))
        for name in names:
            columns = np.concatenate([look.changes[name] for look in looks])
            scaled = columns * unit[name] / _si(name) * (number >= start)[:, None]
            ready = solve_triangular(root, scaled, lower=True)
            logs = [_log_ratio(white, ready, k, dof) for k in KAPPA]
            total += weight * float(np.mean(np.exp(np.minimum(logs, 500.0)))) / len(names)
    return total


def _si(name: str) -> float:
    """m/s², 1 or rad of a family's unit."""
    return {"bias": MG, "scale": 1e-3, "mounting": DEG}[name]


def _log_ratio(white: Array, columns: Array, kappa: float, dof: float) -> float:
    """log E of one change: V₁ = V₀ + κ² C Cᵀ, in coordinates where V₀ is 1."""
    vectors, values, _ = np.linalg.svd(kappa * columns, full_matrices=False)
    power, n = float(white @ white), white.size
    explained = float(np.sum((vectors.T @ white) ** 2 * values**2 / (1.0 + values**2)))
    logs = np.log1p(power / dof) - np.log1p((power - explained) / dof)
    return float(0.5 * (dof + n) * logs - 0.5 * np.sum(np.log1p(values**2)))


def _block_diagonal(blocks: Sequence[Array]) -> Array:
    from scipy.linalg import block_diag

    return np.asarray(block_diag(*blocks), np.float64)
