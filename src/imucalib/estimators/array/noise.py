"""How the noise of an array's sensors is distributed: its size, growth with the rate, and tails.

A triad's error of one sample is a three-dimensional Student t of scale σ(ω), with
σ(ω)² = σ² f_k² (1 + (c |ω|)²) and ν degrees of freedom (infinite: Gaussian), and what the motion
leaves of it has fewer dimensions: of two IMUs' forces one, along the line between them. Growth,
tails and a factor of one IMU are taken in only when held-out blocks of time gain by them. The t
acts as weights (ν + 3)/(ν + d²) on the samples (Lange, Little, Taylor 1989, JASA 84).

About a fused motion an axis has variance σ_i² + (c f_k |ω|)², with what it shows at rest for σ_i:
there c, f and ν come from the log itself, for what a calibration leaves differs with the motion,
and the stated covariance stands on it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.estimators.array.samples import Pair, Sampled

_NU = (3.0, 4.0, 6.0, 10.0, 25.0)
_GROWTH = (0.3, 0.7, 1.5, 3.0, 7.0, 20.0)
HELD_OUT_NATS = 4.0
#: Share of a gyro's errors below which the motion follows it more than all others together.
_FOLLOWED = 0.5
_FEWEST = 3  # gyros that tell which of them is noisy
_MEDIAN = 2.36597  # of the squared length of three numbers of variance one
_GROWN = np.concatenate([[0.0], np.geomspace(0.03, 30.0, 31)])
_GROSS = 30.0  # squared length in sigmas beyond which a Gaussian triad is no part of the sample
_LEAST = 4.0  # nats by which tails or one IMU's factor must win
_LEFT = 0.02  # least share of its variance that a residual keeps


@dataclass(frozen=True)
class Squares:
    """length : (T, K) squared lengths of residuals, in units of which the variance of one of their
    numbers is that of an axis; numbers : (K,) how many independent numbers each has, up to three"""

    length: Array
    numbers: Array

    def __getitem__(self, rows: Index | Flags) -> Squares:
        return Squares(self.length[rows], self.numbers)

    @property
    def count(self) -> float:
        return float(len(self.length) * self.numbers.sum())


@dataclass(frozen=True)
class MotionNoise:
    """sigma : of one axis at rest of the rotation; growth : c, s/rad; freedom : ν;
    factor : (K,) of each triad; gained : held-out nats of what is not plain"""

    sigma: float
    growth: float
    freedom: float
    factor: Array
    gained: float = 0.0

    def variance(self, speed: Array) -> Array:
        """(T, K) squared scale at speeds (T,) rad/s."""
        grown = self.sigma**2 * (1.0 + (self.growth * speed) ** 2)
        return np.asarray(grown[:, None] * self.factor**2)

    def weight(self, square: Array, speed: Array) -> Array:
        """(T, K) inverse variances, given the squared lengths of the residuals."""
        variance = self.variance(speed)
        if not np.isfinite(self.freedom):
            return 1.0 / variance
        return np.asarray((self.freedom + 3.0) / (self.freedom + square / variance) / variance)

    @property
    def information(self) -> float:
        """What a residual tells of its location over what its mean weight says (Fisher information
        of a multivariate t, Lange, Little, Taylor 1989): 1 for a Gaussian, 3/4 for ν = 3."""
        if not np.isfinite(self.freedom):
            return 1.0
        return (self.freedom + 3.0) / (self.freedom + 5.0)


def weigh(noise: tuple[MotionNoise, MotionNoise], off: Pair, rate: Array) -> Pair:
    """Weights (n, K) of readings with residuals off (n, K, 3), turning by rate (n, 3) rad/s."""
    speed = np.linalg.norm(rate, axis=1)
    square = (np.sum(own**2, axis=2) for own in off)
    return Pair(*(one.weight(d, speed) for one, d in zip(noise, square, strict=True)))


def log_density(noise: MotionNoise, square: Squares, speed: Array) -> Array:
    """(T, K) log density of residuals."""
    variance, m = noise.variance(speed), square.numbers
    whitened = _student_density(square.length / variance, m, noise.freedom)
    return np.asarray(whitened - 0.5 * m * np.log(variance))


def _student_density(square: Array, count: Array, freedom: float) -> Array:
    """Log density of a Student t of unit scale in `count` dimensions, at squared lengths."""
    from scipy.special import gammaln

    if not np.isfinite(freedom):
        return np.asarray(-0.5 * square - 0.5 * count * np.log(2.0 * np.pi))
    whole = freedom + count
    level = gammaln(0.5 * whole) - gammaln(0.5 * freedom) - 0.5 * count * np.log(freedom * np.pi)
    return np.asarray(level - 0.5 * whole * np.log1p(square / freedom))


def rescale(noise: MotionNoise, square: Squares, speed: Array) -> MotionNoise:
    """The same with its most likely scale: a few steps of expectation maximisation."""
    unit = square.length / (noise.variance(speed) / noise.sigma**2)
    if not np.isfinite(noise.freedom):
        return replace(noise, sigma=float(np.sqrt(unit.sum() / square.count)))
    sigma, nu = noise.sigma, noise.freedom
    for _ in range(12):
        heavy = np.sum(unit / (nu + unit / sigma**2), axis=0) @ (nu + square.numbers)
        before, sigma = sigma, float(np.sqrt(heavy / square.count))
        if abs(sigma / before - 1.0) < 1e-3:
            break
    return replace(noise, sigma=sigma)


def plain_noise(square: Squares, speed: Array) -> MotionNoise:
    """Gaussian noise of one size."""
    start = float(np.sqrt(np.median(square.length / square.numbers)))
    noise = MotionNoise(max(start, 1e-12), 0.0, np.inf, np.ones(len(square.numbers)))
    return rescale(noise, square, speed)


def _every_shape(square: Squares, speed: Array) -> Iterator[MotionNoise]:
    """The most likely noise of each shape, from the simplest: without growth and with it, each
    without tails and with them, each without a factor of single triads and with it."""
    plain = plain_noise(square, speed)
    unit = 1.0 / max(float(np.median(speed)), 1e-9)
    for growth in ((), tuple(g * unit for g in _GROWTH)):
        for tails in ((), _NU):
            noise = plain
            for _ in range(2 if growth and tails else 1):
                grown = [noise, *(replace(noise, growth=g) for g in growth)]
                noise = _likeliest(grown, square, speed)
                tailed = [noise, *(replace(noise, freedom=nu) for nu in tails)]
                noise = _likeliest(tailed, square, speed)
            yield noise
            yield replace(noise, factor=np.sqrt(_power_of_each(noise, square, speed)))


def _likeliest(options: list[MotionNoise], square: Squares, speed: Array) -> MotionNoise:
    if len(options) == 1:
        return options[0]
    found = [rescale(one, square, speed) for one in options]
    return max(found, key=lambda one: float(log_density(one, square, speed).sum()))


def _power_of_each(noise: MotionNoise, square: Squares, speed: Array) -> Array:
    """(K,) mean weighted square of one number of each triad: one where the noise is as stated."""
    d, nu = square.length / noise.variance(speed), noise.freedom
    heavy = d if not np.isfinite(nu) else (nu + square.numbers) / (nu + d) * d
    return np.asarray(np.mean(heavy, axis=0) / square.numbers)


def choose_noise(square: Squares, speed: Array, first: Flags) -> MotionNoise:
    """The simplest shape that no other beats by `HELD_OUT_NATS` on held-out halves, both ways.

    first : (T,) which half each sample belongs to
    """
    if min(int(first.sum()), int((~first).sum())) < 10:
        return plain_noise(square, speed)
    gain = np.zeros(8)
    for one, two in ((first, ~first), (~first, first)):
        found = _every_shape(square[one], speed[one])
        gain += [float(log_density(n, square[two], speed[two]).sum()) for n in found]
    gain -= gain[0]
    best = 0
    for shape in range(1, len(gain)):
        if gain[shape] > gain[best] + HELD_OUT_NATS:
            best = shape
    return replace(list(_every_shape(square, speed))[best], gained=float(gain[best]))


def not_followed(noise: MotionNoise, sampled: Sampled, rows: Index) -> MotionNoise:
    """The noise of gyros, in which one that the motion follows is no quieter than the gyros'
    differences at some samples say.

    A residual over the root of the share that the motion leaves of it says how noisy a gyro is, as
    long as something remains. Of few gyros one that counts more leaves less, seems quieter and
    counts more still: one whose errors were the least before any effect was known kept 2 % of its
    noise for good. Differences between gyros hold no motion, however it was weighed (Gray and Allan
    1974, the three-cornered hat).
    """
    share = np.mean(sampled.kept[1].share[rows], axis=0)
    followed = (share < _FOLLOWED) & (noise.factor < 1.0)
    if not followed.any() or len(share) < _FEWEST:
        return noise
    own = _power_apart(sampled.off.rate[rows])
    least = np.where(followed, np.sqrt(own / np.mean(own)), 0.0)
    return replace(noise, factor=np.maximum(noise.factor, least))


def _power_apart(off: Array) -> Array:
    """(K,) mean squares of one number of each triad's errors; by medians, which tails do not move.

    off : (T, K, 3) residuals about one motion of all
    """
    count = off.shape[1]
    square = np.sum((off[:, :, None] - off[:, None]) ** 2, axis=3)
    pair = np.median(square, axis=0) / _MEDIAN
    whole = pair.sum() / (2.0 * (count - 1))
    return np.asarray(np.maximum((pair.sum(axis=1) - whole) / (count - 2), 0.0))


@dataclass(frozen=True)
class ChipNoise:
    """rest : (K, 3) of one axis at rest; growth : (K,) c f_k, per rad/s; freedom : ν"""

    rest: Array
    growth: Array
    freedom: float

    def variance(self, speed: Array) -> Array:
        """(T, K, 3) at speeds (T,) rad/s."""
        return np.asarray(self.rest**2 + (speed[:, None] * self.growth)[..., None] ** 2)

    def share(self, square: Array, live: Array) -> Array:
        """(T, K) what a triad weighs beside its inverse variance, given its squared length in
        sigmas over `live` (T, K) axes. The t's weight (Lange, Little, Taylor 1989, JASA 84); under
        a Gaussian, what lies far out loses its say."""
        if np.isfinite(self.freedom):
            return np.asarray((self.freedom + live) / (self.freedom + square))
        return np.asarray((_GROSS / np.maximum(square, _GROSS)) ** 2)

    @property
    def widening(self) -> float:
        """Of a covariance from the t's weights: they say more of a place than the t itself does,
        by (ν + 5) / (ν + 3) for three axes."""
        nu = self.freedom
        return (nu + 5.0) / (nu + 3.0) if np.isfinite(nu) else 1.0


def at_rest(rest: Array) -> ChipNoise:
    """Noise (K, 3) that does not grow."""
    return ChipNoise(rest, np.zeros(len(rest)), np.inf)


def fit_noise(off: Array, live: Flags, left: Array, speed: Array, rest: Array) -> ChipNoise:
    """The likeliest noise of residuals.

    off : (T, K, 3) along the sensors' axes; live : (T, K, 3); left : (T, K) share of a triad's
    variance that the motion has not taken; speed : (T,) rad/s; rest : (K, 3)
    """
    square = np.where(live, off**2, 0.0) / np.maximum(left, _LEFT)[..., None]
    fast = float(np.sqrt(np.mean(speed**2))) or 1.0
    growth = _GROWN * float(np.sqrt(np.mean(rest**2))) / fast
    found, best = at_rest(rest), -np.inf
    for nu in (np.inf, *_NU[::-1]):
        tried = [ChipNoise(rest, np.full(len(rest), one), nu) for one in growth]
        table = np.array([_of_triads(one, square, live, speed) for one in tried])
        same, each = int(table.sum(axis=1).argmax()), table.argmax(axis=0)
        value, own = float(table[same].sum()), float(table.max(axis=0).sum())
        apart = own > value + _LEAST * len(rest)
        if (own if apart else value) > best + _LEAST:
            best = own if apart else value
            found = ChipNoise(rest, growth[each] if apart else tried[same].growth, nu)
    return found


def _of_triads(noise: ChipNoise, square: Array, live: Flags, speed: Array) -> Array:
    """(K,) log density of every triad's residuals."""
    variance = noise.variance(speed)
    whitened = _student_density((square / variance).sum(axis=2), live.sum(axis=2), noise.freedom)
    level = 0.5 * np.sum(np.where(live, np.log(variance), 0.0), axis=2)
    return np.asarray((whitened - level).sum(axis=0))
