"""Whether numbers agree with their stated covariances, and how much they scatter beyond.

All agree: χ² = Σ (θ_i - θ̄)ᵀ C_i⁻¹ (θ_i - θ̄), θ̄ by generalised least squares, with (m-1) p degrees
of freedom; since the covariances' scale was estimated, χ² / dof is held against F (ν by
Satterthwaite), where power-ups scatter against what chance does (`chance`). The scatter of one
parameter beyond its sds is that of `beyond`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.comparison.basis import Basis
from imucalib.calibration.comparison.beyond import beyond, chi_square
from imucalib.calibration.comparison.chance import drawn, exceeded


@dataclass(frozen=True)
class Agreement:
    """mean, mean_sd : (p,) of all; z : (m, p) of each against the mean of the others, by its whole
    sd; chi2, dof, p : that all agree; noise_dof : behind the covariances' scale
    without : (m,) p of each calibration against the others, all parameters together
    """

    mean: Array
    mean_sd: Array
    z: Array
    chi2: float
    dof: int
    p: float
    noise_dof: float
    without: Array

    @property
    def z_rms(self) -> float:
        """1 where the scatter is what is stated."""
        return float(np.sqrt(self.chi2 / self.dof))


@dataclass(frozen=True)
class Scatter:
    """Standard deviation between calibrations beyond their own, (p,) each, with its 95 % interval;
    z_rms : (p,) of each parameter alone"""

    sd: Array
    low: Array
    high: Array
    z_rms: Array


def agreement(basis: Basis, seed: int = 0) -> Agreement:
    """Of two or more. seed : of what chance does where power-ups scatter"""
    from scipy.special import fdtrc

    value, covariance = basis.value, basis.covariance
    m, p = value.shape
    null = None if basis.power_ups is None else drawn(basis, np.random.default_rng(seed))
    mean, own = _mean(value, covariance)
    chi2 = float(_squares(value, mean, covariance))
    z, without = np.zeros((m, p)), np.zeros(m)
    for k in range(m):
        rest = np.arange(m) != k
        other, spread = _mean(value[rest], covariance[rest])
        whole = covariance[k] + spread
        z[k] = (value[k] - other) / np.sqrt(np.diag(whole))
        square = _square(value[k] - other, whole)
        if null is not None:
            away = null[:, k] - _mean(null[:, rest], covariance[rest])[0]
            without[k] = exceeded(_square(away, whole), float(square))
            continue
        pair = np.array([covariance[k], spread])
        dof = noise_dof(pair, np.array([basis.dof[k], basis.dof[rest].sum()]))
        without[k] = fdtrc(p, dof, square / p)
    dof, nu = (m - 1) * p, noise_dof(covariance, basis.dof)
    chance = float(fdtrc(dof, nu, chi2 / dof))
    if null is not None:
        chance = exceeded(_squares(null, _mean(null, covariance)[0], covariance), chi2)
    return Agreement(
        mean=mean, mean_sd=np.sqrt(np.diag(own)), z=z, chi2=chi2, dof=dof, p=chance, noise_dof=nu,
        without=without,
    )  # fmt: skip


def odd_ones(basis: Basis, alpha: float) -> tuple[int, ...]:
    """Calibrations without which the others agree, fewer than half of all; none where all agree,
    and none where more would have to go: then they scatter."""
    left, gone = list(range(len(basis.value))), list[int]()
    while agreement(_some(basis, left)).p <= alpha:
        if len(left) < 3 or 2 * (len(gone) + 1) >= len(basis.value):
            return ()
        rest = [[k for k in left if k != out] for out in left]
        best = int(np.argmin([agreement(_some(basis, some)).chi2 for some in rest]))
        gone.append(left[best])
        left = rest[best]
    return tuple(sorted(gone))


def _some(basis: Basis, of: list[int]) -> Basis:
    days = basis.power_ups
    return replace(
        basis,
        value=basis.value[of],
        covariance=basis.covariance[of],
        dof=basis.dof[of],
        power_ups=days and replace(days, share=[days.share[k] for k in of]),
    )


def noise_dof(covariance: Array, dof: Array) -> float:
    """ν of a sum of covariances (k, p, p), each with its own dof (k,), by its share."""
    total = np.linalg.pinv(covariance.sum(axis=0), hermitian=True)
    share = np.einsum("ij,kji->k", total, covariance)
    share = share / share.sum()
    return float(1.0 / np.sum(share**2 / dof))


def scatter(basis: Basis) -> Scatter | None:
    """Parameter by parameter; None of fewer than three calibrations."""
    m = len(basis.value)
    if m < 3:
        return None
    variance = np.einsum("kii->ki", basis.covariance)
    pairs = list(zip(basis.value.T, variance.T, strict=True))
    found = [beyond(value, own) for value, own in pairs]
    sd, low, high = (np.array([getattr(one, k) for one in found]) for k in ("sd", "low", "high"))
    z_rms = np.sqrt([chi_square(value, own) / (m - 1) for value, own in pairs])
    return Scatter(sd, low, high, z_rms)


def _mean(value: Array, covariance: Array) -> tuple[Array, Array]:
    """Generalised least squares mean (..., p) of values (..., m, p) and its covariance (p, p)."""
    weight = np.linalg.pinv(covariance, hermitian=True)
    own = np.linalg.pinv(weight.sum(axis=0), hermitian=True)
    return np.einsum("kij,...kj->...i", weight, value) @ own, own


def _square(difference: Array, covariance: Array) -> Array:
    """(...,) of differences (..., p)."""
    inverse = np.linalg.pinv(covariance, hermitian=True)
    return np.asarray(np.einsum("...i,ij,...j->...", difference, inverse, difference))


def _squares(value: Array, mean: Array, covariance: Array) -> Array:
    """(...,) of all calibrations, value (..., m, p), about their means (..., p)."""
    each = [_square(value[..., k, :] - mean, c) for k, c in enumerate(covariance)]
    return np.asarray(np.sum(each, axis=0))
