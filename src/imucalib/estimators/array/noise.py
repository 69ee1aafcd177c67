"""How the noise of an array's sensors is distributed: its size, growth with the rate, and tails.

A triad's error of one sample is a three-dimensional Student t of scale σ(ω), with
σ(ω)² = σ² f_k² (1 + (c |ω|)²) and ν degrees of freedom (infinite: Gaussian), and what the motion
leaves of it has fewer dimensions: of two IMUs' forces one, along the line between them. Growth,
tails and a factor of one IMU are taken in only when held-out blocks of time gain by them. The t
acts as weights (ν + 3)/(ν + d²) on the samples (Lange, Little, Taylor 1989, JASA 84).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.estimators.array.samples import Sampled

_NU = (3.0, 4.0, 6.0, 10.0, 25.0)
_GROWTH = (0.3, 0.7, 1.5, 3.0, 7.0, 20.0)
HELD_OUT_NATS = 4.0
#: Share of a gyro's errors below which the motion follows it more than all others together.
_FOLLOWED = 0.5
_FEWEST = 3  # gyros that tell which of them is noisy
_MEDIAN = 2.36597  # of the squared length of three numbers of variance one


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


def log_density(noise: MotionNoise, square: Squares, speed: Array) -> Array:
    """(T, K) log density of residuals."""
    from scipy.special import gammaln

    variance, m = noise.variance(speed), square.numbers
    d, nu = square.length / variance, noise.freedom
    if not np.isfinite(nu):
        return np.asarray(-0.5 * d - 0.5 * m * np.log(2.0 * np.pi * variance))
    level = gammaln(0.5 * (nu + m)) - gammaln(0.5 * nu) - 0.5 * m * np.log(nu * np.pi)
    return np.asarray(level - 0.5 * m * np.log(variance) - 0.5 * (nu + m) * np.log1p(d / nu))


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
