"""Whether numbers agree with their stated covariances, and how much they scatter beyond.

All agree: χ² = Σ (θ_i - θ̄)ᵀ C_i⁻¹ (θ_i - θ̄), θ̄ by generalised least squares, with (m-1) p degrees
of freedom; since the covariances' scale was estimated, χ² / dof is held against F (ν by
Satterthwaite), where power-ups scatter against what chance does (`chance`). The scatter of one
parameter beyond its sds is that of `beyond`.

How far calibrations lie apart by chance, where power-ups scatter.

What readings leave open and what power-ups bring have sizes of their own, known from few of each.
In the directions of a bias the second decides alone, so that no one F holds: calibrations are drawn
with each part's true size as its estimate tells it, size² = estimate² ν / χ²(ν) (Fisher's fiducial
law). The size of what power-ups bring is one, for all.

How much values scatter beyond their own standard deviations, as a whole or within groups.

τ² solves Q(τ²) = Σ (y_i - ȳ)² / (v_i + τ²) = degrees of freedom (Paule and Mandel 1982; the
iterated DerSimonian and Laird 1986), its interval Q(τ²) = the quantiles of χ² (Viechtbauer 2007,
Statistics in Medicine 26, 37-52). ȳ is the mean of all, or of each group.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibration.comparison.basis import Basis
from imucalib.core.eigen import eigen

#: Calibrations that are drawn; p is no finer than one of as many and one.
DRAWS = 6000


def drawn(basis: Basis, rng: np.random.Generator) -> Array:
    """(DRAWS, m, p) values about a common truth."""
    assert basis.power_ups is not None
    m, p = basis.value.shape
    found = np.zeros((DRAWS, m, p))
    common = _size(basis.power_ups.dof, rng)
    for k, share in enumerate(basis.power_ups.share):
        own = basis.covariance[k] - share
        for part, size in ((own, _size(float(basis.dof[k]), rng)), (share, common)):
            found[:, k] += size[:, None] * (rng.standard_normal((DRAWS, p)) @ _root(part))
    return found


def exceeded(squares: Array, found: float) -> float:
    """p of a sum of squares beside those that are drawn."""
    return float((1 + np.count_nonzero(squares >= found)) / (squares.size + 1))


def _size(dof: float, rng: np.random.Generator) -> Array:
    if not np.isfinite(dof):
        return np.ones(DRAWS)
    return np.asarray(np.sqrt(dof / rng.chisquare(dof, DRAWS)))


def _root(covariance: Array) -> Array:
    values, vectors = eigen(0.5 * (covariance + covariance.T))
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T)


@dataclass(frozen=True)
class Beyond:
    """A standard deviation beyond stated ones, with its 95 % interval, in the values' unit."""

    sd: float
    low: float
    high: float


def beyond(value: Array, variance: Array, group: Index | None = None) -> Beyond:
    """Of values (m,) with variances (m,); group : (m,) whose means differ anyhow, or one for all.

    NaN where no group holds two.
    """
    from scipy.special import chdtri

    dof = value.size - (1 if group is None else np.unique(group).size)
    if dof < 1:
        return Beyond(float("nan"), float("nan"), float("nan"))
    wanted = (float(dof), float(chdtri(dof, 0.025)), float(chdtri(dof, 0.975)))
    return Beyond(*(_solved(q, value, variance, group) for q in wanted))


def beyond_sd(value: Array, variance: Array) -> float:
    """The same of one group, without its interval."""
    return _solved(value.size - 1.0, value, variance, None)


def chi_square(value: Array, variance: Array) -> float:
    """Weighted squares of values (m,) about their mean."""
    return _q(0.0, value, variance, None)


def _q(square: float, value: Array, variance: Array, group: Index | None) -> float:
    weight = 1.0 / (variance + square)
    if group is None:
        return float(weight @ (value - weight @ value / weight.sum()) ** 2)
    total = np.bincount(group, weight)
    mean = np.bincount(group, weight * value) / np.where(total > 0.0, total, 1.0)
    return float(weight @ (value - mean[group]) ** 2)


def _solved(wanted: float, value: Array, variance: Array, group: Index | None) -> float:
    """τ where Q(τ²) is so large; 0 where it never is."""
    from scipy.optimize import brentq

    if _q(0.0, value, variance, group) <= wanted:
        return 0.0
    high = float(np.ptp(value)) ** 2 + float(variance.max())
    while _q(high, value, variance, group) > wanted:
        high *= 4.0
    return float(
        np.sqrt(brentq(lambda s: _q(s, value, variance, group) - wanted, 0.0, high, xtol=1e-30))
    )


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
class ParameterScatter:
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
        mean=mean,
        mean_sd=np.sqrt(np.diag(own)),
        z=z,
        chi2=chi2,
        dof=dof,
        p=chance,
        noise_dof=nu,
        without=without,
    )


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


def scatter(basis: Basis) -> ParameterScatter | None:
    """Parameter by parameter; None of fewer than three calibrations."""
    m = len(basis.value)
    if m < 3:
        return None
    variance = np.einsum("kii->ki", basis.covariance)
    pairs = list(zip(basis.value.T, variance.T, strict=True))
    found = [beyond(value, own) for value, own in pairs]
    sd, low, high = (np.array([getattr(one, k) for one in found]) for k in ("sd", "low", "high"))
    z_rms = np.sqrt([chi_square(value, own) / (m - 1) for value, own in pairs])
    return ParameterScatter(sd, low, high, z_rms)


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
