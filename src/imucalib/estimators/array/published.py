"""Paper 001 as published: its likelihood with the motion integrated out, and Algorithm 1.

y_kt = W_t r_k + s_t + e_kt with W_t = Ω(ω_t)² + Ω(dω_t/dt), r_1 = 0; gyros give ω_t (eqs. 4 and 5).
dω/dt and s_t are integrated out flat, which pulls the array's size to zero by 3 T times its
variance (T integrals, each worth |J|^-1/2). The determinant's exponent is 1/2: a Gaussian of
covariance M carries |2πM|^-1/2, and as the motion's prior widens |M| tends to a constant times
|HᵀLH|, with L the accelerometers' precision; (25) and (26) as printed lack the square root.

The chain is pseudo-marginal Metropolis-Hastings. Each proposal of the isotropic random walk (27) is
judged by the Monte Carlo likelihood (26): N rates a sample drawn from what the gyros say, ω̇ and s
integrated out in closed form, log-sum-exp. N is raised until the log likelihood's variance at the
prior mean is 0.1, then the step length is set to an acceptance of 7 to 23 % (section III-C); the
burn-in ends when chains from different starts have reached the same level.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.errors import NotConverged

ACCEPTANCE = (0.07, 0.23)
VARIANCE = 0.1
_REPEATS = 100  # likelihoods from which a variance is estimated
_MOST = 20_000  # rates drawn for a sample, beyond which (26) is not usable
_TUNING = 200  # iterations between two looks at the acceptance


@dataclass(frozen=True)
class ArrayData:
    """Moving samples of an array.

    acceleration : (T, A, 3) m/s², calibrated triads in the array's frame
    sigma : (A,) m/s², standard deviation of each triad, the same on its three axes
    rate : (T, 3) rad/s, mean of the gyros; rate_precision : (T, 3, 3) (rad/s)^-2
    """

    acceleration: Array
    sigma: Array
    rate: Array
    rate_precision: Array

    @property
    def samples(self) -> int:
        return len(self.acceleration)

    @cached_property
    def weight(self) -> Array:
        """(A,) 1/σ²."""
        return np.asarray(self.sigma**-2.0)

    @cached_property
    def centred(self) -> Array:
        """(T, A, 3) acceleration less its weighted mean over the triads."""
        mean = np.einsum("tai,a->ti", self.acceleration, self.weight) / self.weight.sum()
        return np.asarray(self.acceleration - mean[:, None])


@dataclass(frozen=True)
class DrawnPrior:
    """Positions about the drawing. nominal : (A, 3) m, in the array's frame; sd : m, of each
    coordinate of triads 2 to A relative to triad 1"""

    nominal: Array
    sd: float = 3e-3

    @property
    def size(self) -> int:
        return 3 * (len(self.nominal) - 1)

    @property
    def mean(self) -> Array:
        """(size,) m."""
        return np.asarray((self.nominal[1:] - self.nominal[0]).ravel())


def log_likelihood(data: ArrayData, x: Array, rate: Array) -> Array:
    """(B, N, T) log density of every sample's accelerations at positions x (B, size), m, given
    rates (N, T, 3) rad/s: equation (23) in closed form over s and dω/dt.

    With N = Σ λ y rᵀ over triads about their weighted mean and J = Σ λ (|r|² I - r rᵀ), -2 log p is
    yᵀy - 2 ωᵀNω + 2 |ω|² tr N + |ω|² ωᵀJω - vᵀJ⁻¹v, v = vee(N) - ω x Jω, up to the determinants.
    """
    lam, a = data.weight, data.acceleration.shape[1]
    r = np.concatenate([np.zeros((len(x), 1, 3)), x.reshape(len(x), -1, 3)], axis=1)
    r = r - (lam / lam.sum() @ r)[:, None]
    spread = np.einsum("baj,bak,a->bjk", r, r, lam)
    inertia = np.trace(spread, axis1=1, axis2=2)[:, None, None] * np.eye(3) - spread
    moment = np.einsum("tai,baj,a->btij", data.centred, r, lam, optimize=True)
    skew = moment.swapaxes(2, 3) - moment
    torque = np.stack([skew[..., 1, 2], skew[..., 2, 0], skew[..., 0, 1]], axis=-1)[:, None]
    square = np.sum(rate * rate, axis=-1)
    jw = np.einsum("bij,ntj->bnti", inertia, rate)
    v = torque - np.cross(rate[None], jw)
    power = np.einsum("tai,tai,a->t", data.centred, data.centred, lam)
    trace = np.einsum("btii->bt", moment)
    value = power - 2.0 * np.einsum("nti,btij,ntj->bnt", rate, moment, rate, optimize=True)
    value = value + square * (2.0 * trace[:, None] + np.einsum("nti,bnti->bnt", rate, jw))
    value = value - np.einsum("bnti,bij,bntj->bnt", v, np.linalg.inv(inertia), v, optimize=True)
    level = -0.5 * (np.linalg.slogdet(inertia)[1] + 3.0 * np.log(lam.sum()))
    level = level + 1.5 * np.log(lam).sum() - 1.5 * (a - 2) * np.log(2.0 * np.pi)
    return np.asarray(level[:, None, None] - 0.5 * value)


@dataclass(frozen=True)
class PmmhResult:
    """draws (chains, n, size) of the unknowns after the burn-in; monte_carlo: N; variance of the
    log likelihood with it; accepted; burn_in: iterations before the draws."""

    draws: Array
    monte_carlo: int
    variance: float
    accepted: float
    burn_in: int


@dataclass(frozen=True)
class MonteCarloLikelihood:
    """p̂_N(y | unknowns) of (26): one estimate a row, from fresh draws."""

    data: ArrayData
    prior: DrawnPrior
    count: int

    def log(self, x: Array, rng: np.random.Generator) -> Array:
        """(B,) log of unbiased estimates at positions (B, size), each from rates of its own."""
        from scipy.special import logsumexp

        root = np.linalg.cholesky(np.linalg.inv(self.data.rate_precision))
        values = np.empty(len(x))
        for k, one in enumerate(x):
            white = rng.standard_normal((self.count, self.data.samples, 3))
            rate = self.data.rate + np.einsum("tij,ntj->nti", root, white)
            each = log_likelihood(self.data, one[None], rate)[0]
            values[k] = np.sum(logsumexp(each, axis=0) - np.log(self.count))
        return values

    def log_posterior(self, x: Array, rng: np.random.Generator) -> Array:
        """(B,) the same with the prior."""
        off = (x - self.prior.mean) / self.prior.sd
        return np.asarray(self.log(x, rng) - 0.5 * np.sum(off * off, axis=1))


def run_pmmh(
    data: ArrayData,
    prior: DrawnPrior,
    rng: np.random.Generator,
    *,
    iterations: int = 100_000,
    chains: int = 2,
) -> PmmhResult:
    """Algorithm 1. Raises NotConverged when N or the burn-in cannot be found."""
    likelihood, variance = tune_count(data, prior, rng)
    x = prior.mean + prior.sd * rng.standard_normal((chains, prior.size))
    walk = _Walk(x, likelihood.log_posterior(x, rng), 0.01)
    walk, burn_in = _burn_in(walk, likelihood, rng, iterations)
    draws, accepted = np.empty((chains, iterations, prior.size)), 0.0
    for k in range(iterations):
        walk, moved = _iterate(walk, likelihood, rng)
        draws[:, k] = walk.x
        accepted += float(moved.mean()) / iterations
    return PmmhResult(draws, likelihood.count, variance, accepted, burn_in)


def tune_count(
    data: ArrayData, prior: DrawnPrior, rng: np.random.Generator
) -> tuple[MonteCarloLikelihood, float]:
    """The estimator with N such that var log p̂ at the prior mean is at most 0.1, and that
    variance, which falls about as 1/N."""
    count = 1
    while count <= _MOST:
        estimator = MonteCarloLikelihood(data, prior, count)
        x = prior.mean[None]
        values = [estimator.log(x, rng)[0] for _ in range(_REPEATS)]
        variance = float(np.var(values, ddof=1))
        if variance <= VARIANCE:
            return estimator, variance
        count = max(count + 1, min(4 * count, int(np.ceil(1.1 * count * variance / VARIANCE))))
    raise NotConverged(
        f"{_MOST} Monte Carlo rates a sample leave the log likelihood a variance above {VARIANCE}",
        remedy="the gyros are too uncertain for --as-published: use fewer --samples",
    )


@dataclass(frozen=True)
class _Walk:
    x: Array
    level: Array
    step: float


def _iterate(
    walk: _Walk, likelihood: MonteCarloLikelihood, rng: np.random.Generator
) -> tuple[_Walk, Flags]:
    there = walk.x + walk.step * likelihood.prior.sd * rng.standard_normal(walk.x.shape)
    level = likelihood.log_posterior(there, rng)
    moved = np.log(rng.random(len(level))) < level - walk.level
    x = np.where(moved[:, None], there, walk.x)
    return _Walk(x, np.where(moved, level, walk.level), walk.step), np.asarray(moved)


def _burn_in(
    walk: _Walk, likelihood: MonteCarloLikelihood, rng: np.random.Generator, most: int
) -> tuple[_Walk, int]:
    """Walk, adapting the step length, until the chains are at one level that no longer rises."""
    before = np.full(len(walk.x), -np.inf)
    settled = 0
    for k in range(max(most // _TUNING, 20) * 5):
        levels, accepted = [], 0.0
        for _ in range(_TUNING):
            walk, moved = _iterate(walk, likelihood, rng)
            levels.append(walk.level)
            accepted += float(moved.mean()) / _TUNING
        mean, spread = np.mean(levels, axis=0), np.std(levels, axis=0).mean() + 1.0
        level = np.ptp(mean) < 2.0 * spread and np.all(mean - before < spread)
        settled = settled + 1 if level and ACCEPTANCE[0] <= accepted <= ACCEPTANCE[1] else 0
        if settled == 5:
            return walk, (k + 1) * _TUNING
        if not ACCEPTANCE[0] <= accepted <= ACCEPTANCE[1]:
            walk = replace(walk, step=walk.step * float(np.exp(2.0 * (accepted - 0.15))))
        before = mean
    raise NotConverged(
        f"the chains have not reached one level after {(k + 1) * _TUNING} iterations",
        remedy="give more --iterations, or leave --as-published out",
    )
