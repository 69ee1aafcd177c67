"""The covariance of overlapping Allan variances, and what noise they come from.

σ²(τ) = Σ pₖ sₖ(τ), with the terms of IEEE Std 952-1997, annex C, whose integral x(t) has the
generalised covariance R(s):

    quantisation Q²  3/τ²        δ(s)
    white        N²  1/τ         -|s|/2
    instability  B²  2 ln 2/π    s² ln|s|/2π
    walk         K²  τ/3         |s|³/12
    ramp         R²  τ²/2        of no random part

A variance is half of the mean square of d(t) = (x(t+2τ) - 2 x(t+τ) + x(t))/τ at every sample of
a stretch. With c(s) = E dᵢ(t) dⱼ(t+s), which follows from R, and the n(s) pairs of places that a
stretch has s apart, the covariance of two variances is Σ n(s) [c(s)² + 2 mᵢ mⱼ c(s)] / (2 Mᵢ Mⱼ),
where m = R τ is the mean of d and M the number of places (Isserlis 1918). So it is a quadratic
form of p, whose arrays are made once a recording.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from imucalib.arrays import Array, Flags, Index

#: Share of the variance at τ per squared coefficient, and its power of τ.
SHAPES = {
    "quantisation": (3.0, -2.0),
    "white": (1.0, -1.0),
    "instability": (2.0 * np.log(2.0) / np.pi, 0.0),
    "walk": (1.0 / 3.0, 1.0),
    "ramp": (0.5, 2.0),
}
_COUNT = 500  # particles
_MOVES = 6  # of each at every step
_ABOVE = 4.0  # nats that the least of few variances may lie below its mean
_RANGE = 16.0  # nats that the prior is wide
_BENT = 2.0  # sd of the logarithm of a variance that no sum explains
_ROUNDING = 1e-4  # of the diagonal
_FEWEST = 4  # values of a curve that must be explained
_RANDOM = 4  # terms with a random part: all but the last
_FINE = 8  # places within the shorter τ at which c(s) is taken, at most
_NEAR = 6  # shorter τ about an edge within which all of these are taken
_TAIL = 3.0  # of the sum of both τ, to which c(s) is followed


def shapes(tau: Array) -> Array:
    """(M, 5) variance per squared coefficient at τ (M,) s."""
    return np.stack([factor * tau**power for factor, power in SHAPES.values()], axis=-1)


def freedom_of(p: Array, tau: Array, forms: Array) -> Array:
    """(M,) degrees of freedom of the variances: twice the squared mean over the variance, for
    squared coefficients p (5,)."""
    mean = shapes(tau) @ p
    own = np.einsum("k,l,klm->m", p, p, np.diagonal(forms, axis1=2, axis2=3))
    return np.asarray(2.0 * mean**2 / np.maximum(own, 1e-300))


def _integral(s: Array) -> Array:
    """(4, ...) generalised covariance of the integral of each random term, s in samples."""
    size = np.abs(s)
    safe = np.where(size > 0.0, size, 1.0)
    return np.stack(
        [
            np.where(size < 1e-9, 1.0, 0.0),
            -0.5 * size,
            size**2 * np.log(safe) / (2.0 * np.pi),
            size**3 / 12.0,
        ]
    )


@cache
def _share(fine: int, octaves: int) -> tuple[Array, Array, Array]:
    """Lags (L,) from the start of a d of unit τ to that of one of 2^octaves, what each stands for,
    and (4, L) c there. Fine about the three edges of the longer τ, where c bends; wider beyond."""
    ratio = 2.0**octaves
    near = np.arange(_NEAR * fine + 1) / fine
    far = np.geomspace(_NEAR, _TAIL * (1.0 + ratio), 24 * (octaves + 4))[1:]
    off = np.concatenate([-far[::-1], -near[:0:-1], near, np.round(far * fine) / fine])
    lag = np.unique(np.round(np.add.outer(-ratio * np.arange(3), off) * fine)) / fine
    weight = np.gradient(lag)
    weight[[0, -1]] *= 0.5
    bend = (1.0, -2.0, 1.0)
    c = sum(
        bend[a] * bend[b] * _integral(fine * (lag + b * ratio - a))
        for a in range(3)
        for b in range(3)
    )
    power = np.arange(4.0)[:, None]
    return lag, weight, np.asarray(c / fine**power / ratio)


def covariance_forms(samples: Index, lengths: Index, interval: float) -> Array:
    """(5, 5, M, M) arrays C with covariance of the variances = Σ pₖ pₗ Cₖₗ.

    samples : (M,) τ in samples, powers of two, growing; lengths : samples of each stretch, whose
        squares are pooled; interval : s between samples
    """
    each, count = np.unique(lengths, return_counts=True)
    places = np.maximum(each[:, None] + 1 - 2 * samples, 0)
    size, terms, total = len(samples), len(SHAPES), count @ places
    found = np.zeros((terms, terms, size, size))
    for i in range(size):
        for j in range(i, size):
            form = _form(int(samples[i]), int(samples[j]), places[:, [i, j]], count, interval)
            found[:, :, i, j] = found[:, :, j, i] = form
    return np.asarray(found / np.maximum(np.outer(total, total), 1.0))


def _form(short: int, long: int, places: Index, count: Index, interval: float) -> Array:
    """(5, 5) half of the sum over all pairs of places. places : (S, 2) of either τ in a stretch;
    count : (S,) of such stretches"""
    fine = min(short, _FINE)
    lag, step, c = _share(fine, round(np.log2(long / short)))
    lag, step = lag * short, step * short
    # Places t of the shorter and t + lag of the longer.
    pairs = np.minimum(places[:, :1], places[:, 1:] - lag) - np.maximum(0.0, -lag)
    weight = count @ np.maximum(pairs, 0.0) * step / 2.0
    tau = short * interval
    unit = tau ** np.array([-2.0, -1.0, 0.0, 1.0])
    c = c * unit[:, None]
    found = np.zeros((_RANDOM + 1, _RANDOM + 1))
    found[:_RANDOM, :_RANDOM] = (c * weight) @ c.T
    found[:_RANDOM, -1] = found[-1, :_RANDOM] = (c @ weight) * tau * (long * interval)
    # A delta is met at one sample alone, not all along a step.
    edge = short / fine
    found[0], found[1:, 0] = found[0] / edge, found[1:, 0] / edge
    return found


def draws(
    samples: Index,
    variance: Array,
    forms: Array,
    interval: float,
    *,
    rng: np.random.Generator,
    count: int = _COUNT,
) -> Array:
    """(count, 8) draws of the posterior: the logarithms of p (5), the logarithm of what the
    variances scatter beyond it, relative, and how many of the shortest and of the longest τ no sum
    explains: filters bend the ones, hands and tables the others.

    Cube roots of variances over their means are normal, as those of chi-square numbers of the same
    spread (Wilson and Hilferty 1931). Priors are flat in the logarithms over `spans`; half of the
    prior is on no τ that is left out at an end, and each more is half as likely. From prior to
    posterior the particles go by steps that keep half of them (Del Moral, Doucet and Jasra 2006),
    and move by differences of one another (ter Braak 2006).

    samples, interval : as `covariance_forms`, which made forms; variance : (M,), positive
    """
    target = _Target(np.asarray(samples * interval, float), variance, forms)
    x = target.start(count, rng)
    log, heat = target(x), 0.0
    while heat < 1.0:
        step = _step(log, 1.0 - heat)
        weight = np.exp(step * (log - log.max()))
        heat += step
        kept = _resample(weight / weight.sum(), rng)
        x, log = x[kept], log[kept]
        for turn in range(_MOVES):
            x, log = _move(target, x, log, heat, turn, rng)
    return x


def _step(log: Array, left: float) -> float:
    """The share of the likelihood that halves the effective number of particles."""

    def effective(step: float) -> float:
        weight = np.exp(step * (log - log.max()))
        return float(weight.sum() ** 2 / np.sum(weight**2))

    low, high = 0.0, left
    if effective(left) >= 0.5 * len(log):
        return left
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= 0.5 * len(log) else (low, middle)
    return max(low, 1e-9)


def _resample(weight: Array, rng: np.random.Generator) -> Index:
    """Systematic resampling (Kitagawa 1996)."""
    at = (rng.random() + np.arange(len(weight))) / len(weight)
    return np.minimum(np.searchsorted(np.cumsum(weight), at), len(weight) - 1)


def _move(
    target: _Target, x: Array, log: Array, heat: float, turn: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Every particle by the difference of two others, and every other turn another number of τ."""
    n, d = x.shape
    one, other = rng.integers(n, size=(2, n))
    length = 1.0 if turn % 3 == 2 else 2.38 / np.sqrt(2.0 * d)
    own = rng.random((n, d)) < rng.choice([0.3, 1.0], size=(n, 1))
    step = length * rng.uniform(0.6, 1.2, (n, 1)) * (x[one] - x[other])
    new = x + own * (step + 1e-4 * rng.standard_normal((n, d)))
    new[:, -2:] = x[:, -2:]
    if turn % 2:
        new[:, -2:] += rng.integers(-1, 2, (n, 2))
    found = target(new)
    prior = target.log_prior(new) - target.log_prior(x)
    with np.errstate(invalid="ignore"):
        taken = np.log(rng.random(n)) < heat * (found - log) + prior
    return np.where(taken[:, None], new, x), np.where(taken, found, log)


class _Target:
    """The posterior's two parts at many points."""

    def __init__(self, tau: Array, variance: Array, forms: Array) -> None:
        self._variance, self._shape = variance, shapes(tau)
        self._forms = forms.reshape(-1, forms.shape[2] * forms.shape[3])
        self.low, self.high = spans(tau, variance)
        self._most = len(tau) - _FEWEST

    def start(self, count: int, rng: np.random.Generator) -> Array:
        """(count, 8) draws of the prior."""
        x = rng.uniform(self.low, self.high, (count, len(self.low)))
        left = np.minimum(rng.geometric(0.5, (count, 2)) - 1, self._most // 2)
        return np.column_stack([x, left])

    def log_prior(self, x: Array) -> Array:
        inside = np.all((x[:, :6] >= self.low) & (x[:, :6] <= self.high), axis=1)
        left = x[:, 6:].sum(axis=1)
        inside &= (x[:, 6:] >= 0).all(axis=1) & (left <= self._most)
        return np.where(inside, -np.log(2.0) * left, -np.inf)

    def __call__(self, x: Array) -> Array:
        """(n,) log likelihood."""
        size = self._variance.size
        p = np.exp(np.clip(x[:, :5], self.low[:5] - 1.0, self.high[:5] + 1.0))
        mean = p @ self._shape.T
        each = (p[:, :, None] * p[:, None, :]).reshape(len(p), -1) @ self._forms
        each = each.reshape(-1, size, size) / (mean[:, :, None] * mean[:, None, :])
        own = np.diagonal(each, axis1=1, axis2=2).copy()
        extra = np.exp(2.0 * np.minimum(x[:, 5:6], 1.0)) + _ROUNDING * own
        extra = extra + _BENT**2 * find_unexplained(size, x)
        each[:, np.arange(size), np.arange(size)] += extra
        lower = np.linalg.cholesky(each / 9.0)
        away = np.cbrt(self._variance / mean) - (1.0 - own / 9.0)
        white = np.linalg.solve(lower, away[..., None])[..., 0]
        log_det = 2.0 * np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)
        turn = np.log(mean).sum(axis=1) / 3.0
        return np.asarray(-0.5 * (np.sum(white**2, axis=1) + log_det) - turn)


def find_unexplained(size: int, x: Array) -> Flags:
    """(n, M) which of M averaging times points (n, 8) of `draws` leave out."""
    at = np.arange(size)
    return np.asarray((at < x[:, 6:7]) | (at >= size - x[:, 7:8]))


def spans(tau: Array, variance: Array) -> tuple[Array, Array]:
    """(6,), (6,) the logarithms between which the prior of p and of the scatter is flat: p up to
    all of the variance at every τ, the scatter up to twice a variance, and down by `_RANGE`: so far
    that a scatter which is not there widens nothing."""
    all_of_it = np.log(np.min(variance[:, None] / shapes(tau), axis=0)) + _ABOVE
    top = np.append(all_of_it, np.log(2.0))
    return top - _RANGE, top
