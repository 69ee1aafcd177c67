"""Whether numbers agree with their stated covariances, and how much they scatter beyond.

All agree: χ² = Σ (θ_i - θ̄)ᵀ C_i⁻¹ (θ_i - θ̄), θ̄ by generalised least squares, with (m-1) p degrees
of freedom; since the covariances' scale was estimated, χ² / dof is held against F (ν by
Satterthwaite).

Where power-ups scatter it is held against what chance does: what readings leave open and what
power-ups bring have sizes of their own, known from few of each. In the directions of a bias the
second decides alone, so that no one F holds: calibrations are drawn with each part's true size as
its estimate tells it, size² = estimate² ν / χ²(ν) (Fisher's fiducial law). The size of what
power-ups bring is one, for all.

How much values y scatter beyond their own variances v, about a mean, a mean of each group, or a
line X b: τ² solves Q(τ²) = Σ (y_i - (X b)_i)² / (v_i + τ²) = degrees of freedom (Paule and Mandel
1982; the iterated DerSimonian and Laird 1986), its interval Q(τ²) = the quantiles of χ²
(Viechtbauer 2007, Statistics in Medicine 26, 37-52).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.comparison.basis import Basis
from imucalib.core.eigen import eigen

#: Calibrations that are drawn; p is no finer than one of as many and one.
DRAWS = 6000


@dataclass(frozen=True)
class ExcessScatter:
    """A standard deviation beyond stated ones, with its 95 % interval, in the values' unit."""

    sd: float
    low: float
    high: float


def beyond(value: Array, variance: Array, design: Array | None = None) -> ExcessScatter:
    """Of values (m,) with variances (m,) about `design` (m, k) b, by default one mean.

    NaN where the design leaves no degree of freedom.
    """
    from scipy.special import chdtri

    design = _design(value, design)
    dof = value.size - design.shape[1]
    if dof < 1:
        return ExcessScatter(float("nan"), float("nan"), float("nan"))
    wanted = (float(dof), float(chdtri(dof, 0.025)), float(chdtri(dof, 0.975)))
    return ExcessScatter(*(excess(q, value, variance, design) ** 0.5 for q in wanted))


def excess(wanted: float, value: Array, variance: Array, design: Array | None = None) -> float:
    """τ² of values (m,) at which Q(τ²) is so large; 0 where it never is."""
    from scipy.optimize import brentq

    design = _design(value, design)

    def more(square: float) -> float:
        return weighted_line(value, variance + square, design)[2] - wanted

    if more(0.0) <= 0.0:
        return 0.0
    high = float(np.ptp(value)) ** 2 + float(variance.max())
    while more(high) > 0.0:
        high *= 4.0
    return float(brentq(more, 0.0, high, xtol=1e-30))


def weighted_line(value: Array, variance: Array, design: Array) -> tuple[Array, Array, float]:
    """b (k,) of weighted least squares, its covariance (k, k), and the squares that remain."""
    weighted = design.T / variance
    covariance = np.asarray(np.linalg.inv(weighted @ design), np.float64)
    b = covariance @ (weighted @ value)
    return b, covariance, float(np.sum((value - design @ b) ** 2 / variance))


def _design(value: Array, design: Array | None) -> Array:
    return np.ones((value.size, 1)) if design is None else design


@dataclass(frozen=True)
class Agreement:
    """mean, mean_sd : (p,) of all; z : (m, p) of each against the mean of the others, by its whole
    sd; chi2, dof, p : that all agree; noise_dof : of the covariances' scale
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


def agreement(basis: Basis) -> Agreement:
    """Of two or more."""
    value, covariance = basis.value, basis.covariance
    m, p = value.shape
    null = _draw_truths(basis)
    mean, own = _mean(value, covariance)
    chi2 = float(_squares(value, mean, covariance))
    z, without = np.zeros((m, p)), np.zeros(m)
    for k in range(m):
        rest = np.arange(m) != k
        other, spread = _mean(value[rest], covariance[rest])
        whole = covariance[k] + spread
        z[k] = (value[k] - other) / np.sqrt(np.diag(whole))
        square = float(_square(value[k] - other, whole))
        if null is not None:
            away = null[:, k] - _mean(null[:, rest], covariance[rest])[0]
            without[k] = _p_by_draws(_square(away, whole), square)
        else:
            pair = np.array([covariance[k], spread])
            dofs = np.array([basis.dof[k], basis.dof[rest].sum()])
            without[k] = _tail(square, p, noise_dof(pair, dofs))
    dof, nu = (m - 1) * p, noise_dof(covariance, basis.dof)
    chance = _tail(chi2, dof, nu)
    if null is not None:
        chance = _p_by_draws(_squares(null, _mean(null, covariance)[0], covariance), chi2)
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
    kept, gone = list(range(len(basis.value))), list[int]()
    while agreement(basis.take(kept)).p <= alpha:
        if len(kept) < 3 or 2 * (len(gone) + 1) >= len(basis.value):
            return ()
        rest = [[k for k in kept if k != out] for out in kept]
        best = int(np.argmin([agreement(basis.take(some)).chi2 for some in rest]))
        gone.append(kept[best])
        kept = rest[best]
    return tuple(sorted(gone))


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
    squares = [weighted_line(value, own, np.ones((m, 1)))[2] for value, own in pairs]
    return ParameterScatter(sd, low, high, np.sqrt(np.array(squares) / (m - 1)))


def _draw_truths(basis: Basis) -> Array | None:
    """(DRAWS, m, p) values about a common truth; None where nothing tells what power-ups bring."""
    if basis.power_ups is None:
        return None
    rng, (m, p) = np.random.default_rng(0), basis.value.shape
    found = np.zeros((DRAWS, m, p))
    common = _size(basis.power_ups.dof, rng)
    for k, share in enumerate(basis.power_ups.share):
        own = basis.covariance[k] - share
        for part, size in ((own, _size(float(basis.dof[k]), rng)), (share, common)):
            values, vectors = eigen(0.5 * (part + part.T))
            root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
            found[:, k] += size[:, None] * (rng.standard_normal((DRAWS, p)) @ root)
    return found


def _size(dof: float, rng: np.random.Generator) -> Array:
    if not np.isfinite(dof):
        return np.ones(DRAWS)
    return np.asarray(np.sqrt(dof / rng.chisquare(dof, DRAWS)))


def _p_by_draws(squares: Array, found: float) -> float:
    """p of a sum of squares among those that are drawn."""
    return float((1 + np.count_nonzero(squares >= found)) / (squares.size + 1))


def _tail(square: float, dof: int, noise: float) -> float:
    from scipy.special import fdtrc

    return float(fdtrc(dof, noise, square / dof))


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
