"""Whether calibrations agree, in per cent, and how much they scatter beyond what they state.

All have their parameters in common, unless one differs in a kind of them, or all scatter more than
they state: the posterior of `closed_loop.changes`, with the covariance of each file as well known
as its noise, and what power-ups bring as one part for all.

How much values y scatter beyond their own variances v, about a mean, a mean of each group, or a
line X b: τ² solves Q(τ²) = Σ (y_i - (X b)_i)² / (v_i + τ²) = degrees of freedom (Paule and Mandel
1982; the iterated DerSimonian and Laird 1986), its interval Q(τ²) = the quantiles of χ²
(Viechtbauer 2007, Statistics in Medicine 26, 37-52).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from imucalib.arrays import Array
from imucalib.calibration.checking.noise import KNOWN
from imucalib.calibration.comparison.basis import Basis
from imucalib.posterior.closed_loop.changes import (
    ChangeAnswer,
    ChangeQuestion,
    CovariancePart,
    Suspect,
)

#: Stated standard deviations of a parameter that readings of it show, and the share of a variance
#: that keeps a parameter without any from being certain.
_SHOWN, _LEAST = 5.0, 1e-9


@dataclass(frozen=True)
class ExcessScatter:
    """A standard deviation beyond stated ones, with its 95 % interval, in the values' unit."""

    sd: float
    low: float
    high: float


def estimate_excess(value: Array, variance: Array, design: Array | None = None) -> ExcessScatter:
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
        return fit_line(value, variance + square, design)[2] - wanted

    if more(0.0) <= 0.0:
        return 0.0
    high = float(np.ptp(value)) ** 2 + float(variance.max())
    while more(high) > 0.0:
        high *= 4.0
    return float(brentq(more, 0.0, high, xtol=1e-30))


def fit_line(value: Array, variance: Array, design: Array) -> tuple[Array, Array, float]:
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
    sd; chi2, dof : that all agree; answer : what differs, by `suspect`"""

    mean: Array
    mean_sd: Array
    z: Array
    chi2: float
    dof: int
    answer: ChangeAnswer

    @property
    def z_rms(self) -> float:
        """1 where the scatter is what is stated."""
        return float(np.sqrt(self.chi2 / self.dof))

    @property
    def odd(self) -> tuple[int, ...]:
        """Files that differ from the others in the likeliest explanation, where they do; none of
        two, of which either may."""
        if not self.answer.told or len(self.z) < 3:
            return ()
        names = self.answer.likeliest.names
        return tuple(k for k in range(len(self.z)) if any(_is_of(k, name) for name in names))

    def differs(self, file: int) -> float:
        """Probability that a file differs from the others."""
        holds = self.answer.probability_that
        return holds(lambda names: any(_is_of(file, name) for name in names))


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
    mean, own = _mean(value, covariance)
    z = np.zeros((m, p))
    for k in range(m):
        rest = np.arange(m) != k
        other, spread = _mean(value[rest], covariance[rest])
        z[k] = (value[k] - other) / np.sqrt(np.diag(covariance[k] + spread))
    inverse = np.linalg.pinv(covariance, hermitian=True)
    return Agreement(
        mean=mean,
        mean_sd=np.sqrt(np.diag(own)),
        z=z,
        chi2=float(np.einsum("ki,kij,kj->", value - mean, inverse, value - mean)),
        dof=(m - 1) * p,
        answer=difference_question(basis).answer(),
    )


def difference_question(basis: Basis) -> ChangeQuestion:
    """Which kinds of parameters differ in which file, all in units of their mean stated sd; of two
    files the last stands for both."""
    m, p = basis.value.shape
    sd = np.sqrt(np.einsum("kii->i", basis.covariance) / m)
    sd = np.where(sd > 0.0, sd, 1.0)
    shares = np.zeros_like(basis.covariance)
    if basis.power_ups is not None:
        shares = np.array(basis.power_ups.share)
    own = (basis.covariance - shares) / np.outer(sd, sd) + _LEAST * np.eye(p)
    parts = [
        CovariancePart(_of_file(k, m, own[k]), min(float(basis.dof[k]), KNOWN)) for k in range(m)
    ]
    if basis.power_ups is not None:
        whole = block_diag(*(share / np.outer(sd, sd) for share in shares))
        parts.append(CovariancePart(whole, min(basis.power_ups.dof, KNOWN)))
    unit = np.eye(m * p).reshape(m * p, m, p)
    kinds = dict.fromkeys(map(kind_of, basis.names))
    suspects = [
        Suspect(suspect(kind, k), (_SHOWN * unit[:, k, [kind_of(n) == kind for n in basis.names]],))
        for k in range(m == 2, m)
        for kind in kinds
    ]
    value = (basis.value / sd).ravel()
    return ChangeQuestion(value, tuple(parts), tuple(suspects), np.tile(np.eye(p), (m, 1)))


def kind_of(name: str) -> str:
    """What a parameter is one of: "bias" of "bias_x"."""
    return name.rpartition("_")[0] or name


def suspect(kind: str, file: int) -> str:
    """The name of what differs."""
    return f"{kind} of {file}"


def _is_of(file: int, name: str) -> bool:
    return name.endswith(f" of {file}")


def _of_file(k: int, m: int, covariance: Array) -> Array:
    """(m p, m p) covariance of one file's parameters alone."""
    alone = np.zeros((m, m))
    alone[k, k] = 1.0
    return np.asarray(np.kron(alone, covariance), np.float64)


def scatter(basis: Basis) -> ParameterScatter | None:
    """Parameter by parameter; None of fewer than three calibrations."""
    m = len(basis.value)
    if m < 3:
        return None
    variance = np.einsum("kii->ki", basis.covariance)
    pairs = list(zip(basis.value.T, variance.T, strict=True))
    found = [estimate_excess(value, own) for value, own in pairs]
    sd, low, high = (np.array([getattr(one, k) for one in found]) for k in ("sd", "low", "high"))
    squares = [fit_line(value, own, np.ones((m, 1)))[2] for value, own in pairs]
    return ParameterScatter(sd, low, high, np.sqrt(np.array(squares) / (m - 1)))


def _mean(value: Array, covariance: Array) -> tuple[Array, Array]:
    """Generalised least squares mean (..., p) of values (..., m, p) and its covariance (p, p)."""
    weight = np.linalg.pinv(covariance, hermitian=True)
    own = np.linalg.pinv(weight.sum(axis=0), hermitian=True)
    return np.einsum("kij,...kj->...i", weight, value) @ own, own
