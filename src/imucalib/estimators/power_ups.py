"""Several recordings of one sensor: what they share, what each has of its own, what comes next.

A recording leaves products: information A_l and vector c_l of its parameters x_l, all that is its
own taken out. With x_l = x + u_l, u_l ~ N(0, s²), x flat, what the recordings say of the parts u of
all is again information and vector, and of a size

    log L(s) = -1/2 log|1 + S A S| + 1/2 cᵀ S (1 + S A S)⁻¹ S c,    S = diag(s)

(random effects: Harville 1977, JASA 72). Sizes are known from as many recordings as there are: the
next one is a mixture over those that the data allow, so that few give wide intervals and none of
size zero. Axes of one chip scatter alike within a factor of two, not equally: the size of an axis
is log-normal about that of all, which has the prior 1 / (size + what noise alone does to a
recording's mean); what the axes say of each other is in the weights of each.

Devices of a kind scatter as power-ups of one do, and the next device is foretold alike.

How much values y scatter beyond their own variances v, about a mean, a mean of each group, or a
line X b, with no prior of the size: τ² solves Q(τ²) = Σ (y_i - (X b)_i)² / (v_i + τ²) = degrees of
freedom (Paule and Mandel 1982; the iterated DerSimonian and Laird 1986), its interval Q(τ²) = the
quantiles of χ² (Viechtbauer 2007, Statistics in Medicine 26, 37-52).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index

#: Sizes of a grid that is even in the logarithm; it goes from a share of what noise alone does to
#: so many times the scatter, or the noise where that is larger.
_SIZES, _REACH = 36, (0.05, 30.0)
#: Nats below the likeliest from which on a size of the scatter is not looked at closely.
_FAR = 15.0
#: Share of a scatter below which a noise is none, and the least size that is squared.
_SURE, _LEAST = 1e-9, 1e-100
#: Standard deviation of the log of an axis' scatter about that of all: 60 power-ups of an MPU-9250
#: have 0.46, 0.25 and 0.63 mg.
_UNLIKE = 0.5
#: Sizes, over the typical one, that a parameter may move by from one power-up to the next.
_MOVES = 2.0 ** np.arange(-2.0, 7.0)
#: Prior odds that recordings which are said to be of one sensor differ in more than a power-up.
_ODDS = 0.2


@dataclass(frozen=True)
class Parts:
    """What L recordings say of parts of their own, k numbers each: information (L k, L k) and
    vector (L k,), the recordings' own order outside."""

    information: Array
    vector: Array

    def in_unit(self, slope: Array) -> Parts:
        """Of other numbers, of which slope (k, k) is the derivative by these."""
        back = np.kron(np.eye(len(self.vector) // len(slope)), np.linalg.inv(slope))
        return Parts(back.T @ self.information @ back, back.T @ self.vector)

    def predict(self, size: Array) -> tuple[Array, Array]:
        """(L, k) the parts and (L k, L k) their covariance, of sizes (k,)."""
        every = np.tile(size, len(self.vector) // size.size)
        scaled = np.eye(every.size) + every[:, None] * self.information * every
        covariance = every[:, None] * np.linalg.inv(scaled) * every
        return (covariance @ self.vector).reshape(-1, size.size), covariance

    def log_likelihood(self, size: Array) -> float:
        """Over that of none; sizes (k,)."""
        every = np.tile(size, len(self.vector) // size.size)
        scaled = np.eye(every.size) + every[:, None] * self.information * every
        seen = every * self.vector
        power, volume = seen @ np.linalg.solve(scaled, seen), np.linalg.slogdet(scaled)[1]
        return float(0.5 * power - 0.5 * volume)


def parts_of(information: Array, vector: Array, block: Index, free: Index) -> Parts:
    """Of products (L, p, p) and (L, p): the parts of `block`, where `free` parameters have any
    value in each recording, and all others, any value too, one in all. What no recording tells of
    these takes nothing from the parts."""
    count = information.shape[1]
    kept = np.setdiff1d(np.arange(count), free)
    if free.size:
        across = information[:, free[:, None], kept]
        turn = np.linalg.solve(information[:, free[:, None], free], across).swapaxes(1, 2)
        information = information[:, kept[:, None], kept] - turn @ across
        vector = vector[:, kept] - (turn @ vector[:, free, None])[..., 0]
    own = np.searchsorted(kept, block)
    shared = information[:, own].reshape(-1, kept.size)
    back = shared @ np.linalg.pinv(information.sum(axis=0), hermitian=True)
    whole = -back @ shared.T
    for k, one in enumerate(information):
        at = np.arange(own.size) + own.size * k
        whole[np.ix_(at, at)] += one[np.ix_(own, own)]
    return Parts(whole, vector[:, own].ravel() - back @ vector.sum(axis=0))


def weigh_moved(
    information: Array, vector: Array, blocks: Mapping[str, Index], typical: Array, free: Index
) -> tuple[float, dict[str, float]]:
    """Probability that anything differs from recording to recording, and that each block does, of
    products (L, p, p) and (L, p): nothing, one block or all of them.

    typical : (p,) sizes by which parameters usually would; free : those of each recording anyway
    """
    sets = [(name,) for name in blocks] + ([tuple(blocks)] if len(blocks) > 1 else [])
    logs = [0.0]
    for names in sets:
        block = np.sort(np.concatenate([blocks[name] for name in names]))
        parts = parts_of(information, vector, block, free)
        each = [parts.log_likelihood(size * typical[block]) for size in _MOVES]
        logs.append(float(np.logaddexp.reduce(each) + np.log(_ODDS / _MOVES.size / len(sets))))
    weight = np.exp(np.array(logs) - np.logaddexp.reduce(logs))
    every = list(zip(sets, weight[1:].tolist(), strict=True))
    return 1.0 - float(weight[0]), {n: sum(w for names, w in every if n in names) for n in blocks}


@dataclass(frozen=True)
class NextOne:
    """What recordings or devices say of the next one's k numbers of a kind: a mixture over the
    sizes of the scatter that they allow.

    size : (s,); weight : (k, s) of them; means, variances : (k, s) of the mean of all at each size
    """

    size: Array
    weight: Array
    means: Array
    variances: Array

    @property
    def mean(self) -> Array:
        """(k,) of all."""
        return np.asarray(np.sum(self.weight * self.means, axis=1))

    @property
    def mean_sd(self) -> Array:
        """(k,) of the mean."""
        away = self.means - self.mean[:, None]
        return np.asarray(np.sqrt(np.sum(self.weight * (self.variances + away**2), axis=1)))

    @property
    def sd(self) -> Array:
        """(k,) of the next one, as well as a normal law says it."""
        return np.asarray(np.sqrt(self.weight @ self.size**2 + self.mean_sd**2))

    def scatter(self, share: float) -> Array:
        """(k,) what the scatter is below with a probability."""
        below = np.cumsum(self.weight, axis=1) - 0.5 * self.weight
        return np.array([np.interp(share, own, self.size) for own in below])

    def chance(self, value: Array, sd: Array) -> Array:
        """(k,) that one more, measured with sd (k,), is as far from the others as a value (k,)."""
        from scipy.special import ndtr

        whole = np.sqrt(self.variances + self.size**2 + sd[:, None] ** 2)
        tail = ndtr(-np.abs(value[:, None] - self.means) / whole)
        return np.asarray(2.0 * np.sum(self.weight * tail, axis=1))

    def shrink(self, values: Array, sds: Array) -> Array:
        """(L, k) values with sds (L, k), which the mixture was made of, drawn towards the mean."""
        own = self.size**2 / (self.size**2 + sds[..., None] ** 2)  # (L, k, s)
        each = self.means + own * (values[..., None] - self.means)
        return np.asarray(np.sum(self.weight * each, axis=-1))


def predict_next(values: Array, sds: Array) -> NextOne:
    """By values (L, k) with standard deviations (L, k), each by itself; L is two at least.

    Noise alone does the root of the mean square of all sds, the scatter is the largest of the k.
    The likelihoods, restricted for the mean, are had on the grid of `_SIZES`, then on one of twice
    as many over those within `_FAR` of the likeliest of any of the k, and one size beyond.
    """
    apart = float(np.std(values, axis=0, ddof=1).max())
    noise = max(float(np.sqrt(np.mean(sds**2))), _SURE * apart, _LEAST)
    top = max(apart, noise)
    sizes = np.geomspace(_REACH[0] * noise, _REACH[1] * top, _SIZES)
    for _ in range(2):  # over all sizes, then over those that are likely
        whole = sizes[:, None, None] ** 2 + sds**2  # (s, L, k)
        variances = 1.0 / np.sum(1.0 / whole, axis=1).T
        means = variances * np.sum(values / whole, axis=1).T
        squares = np.sum((values - means.T[:, None]) ** 2 / whole, axis=1).T
        nats = 0.5 * (np.log(variances) - squares - np.sum(np.log(whole), axis=1).T)
        seen = np.flatnonzero(np.any(nats > nats.max(axis=1, keepdims=True) - _FAR, axis=0))
        first, last = max(seen[0] - 1, 0), min(seen[-1] + 1, sizes.size - 1)
        used, sizes = sizes, np.geomspace(sizes[first], sizes[last], 2 * _SIZES)
    return NextOne(used, _weights(used, nats, noise)[1], means, variances)


def sizes_allowed(parts: Parts, sd: float) -> tuple[Array, Array, Array]:
    """Sizes of the scatter of parts, three each, and their weights for all axes and for each.

    sd : that the other axes have while one is weighed, and the scatter that the grid goes by

    Noise alone does the mean of the information's diagonal to the power -1/2.
    """
    noise_alone = float(np.mean(np.diag(parts.information)) ** -0.5)
    sizes = np.geomspace(_REACH[0] * noise_alone, _REACH[1] * max(sd, noise_alone), _SIZES)
    axes = np.eye(3, dtype=bool)
    nats = np.array([[parts.log_likelihood(np.where(axis, s, sd)) for s in sizes] for axis in axes])
    return (sizes, *_weights(sizes, nats, noise_alone))


def _weights(sizes: Array, nats: Array, noise_alone: float) -> tuple[Array, Array]:
    """Of sizes (s,), even in the logarithm, for all axes and for each, by the nats (k, s) of each.
    The law of an axis about a size of all is one over these sizes, cut where they end."""
    likely = np.exp(nats - nats.max(axis=1, keepdims=True))
    about = np.exp(-0.5 * (np.log(sizes[:, None] / sizes) / _UNLIKE) ** 2)
    about = about / about.sum(axis=0)  # (size of an axis, size of all)
    prior = sizes / (sizes + noise_alone)  # 1 / (size + noise) on a grid even in the logarithm
    seen = likely @ about
    all_axes = prior * seen.prod(axis=0)
    each = likely * ((prior * seen.prod(axis=0) / np.maximum(seen, 1e-300)) @ about.T)
    return all_axes / all_axes.sum(), each / each.sum(axis=1, keepdims=True)


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
