"""How the noise of an array's sensors is distributed: its size, growth with the rate, and tails.

A triad's error of one sample is a three-dimensional Student t of scale σ(ω), with
σ(ω)² = σ² f_k² (1 + (c |ω|)²) and ν degrees of freedom (infinite: Gaussian), and what the motion
leaves of it has fewer dimensions: of two IMUs' forces one, along the line between them. Growth,
tails and a factor of one IMU are taken in only when held-out blocks of time gain by them. The t
acts as weights (ν + 3)/(ν + d²) on the samples (Lange, Little, Taylor 1989, JASA 84).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index

_NU = (3.0, 4.0, 6.0, 10.0, 25.0)
_GROWTH = (0.3, 0.7, 1.5, 3.0, 7.0, 20.0)
HELD_OUT_NATS = 4.0


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

    def flat(self) -> tuple[Array, Array]:
        """Both (T K,)."""
        return self.length.ravel(), np.tile(self.numbers, len(self.length))


@dataclass(frozen=True)
class SensorNoise:
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

    @property
    def plain(self) -> bool:
        return (
            self.growth == 0.0
            and not np.isfinite(self.freedom)
            and bool(np.all(self.factor == 1.0))
        )


def log_density(noise: SensorNoise, square: Squares, speed: Array) -> Array:
    """(T, K) log density of residuals."""
    from scipy.special import gammaln

    variance, m = noise.variance(speed), square.numbers
    d, nu = square.length / variance, noise.freedom
    if not np.isfinite(nu):
        return np.asarray(-0.5 * d - 0.5 * m * np.log(2.0 * np.pi * variance))
    level = gammaln(0.5 * (nu + m)) - gammaln(0.5 * nu) - 0.5 * m * np.log(nu * np.pi)
    return np.asarray(level - 0.5 * m * np.log(variance) - 0.5 * (nu + m) * np.log1p(d / nu))


def scaled(noise: SensorNoise, square: Squares, speed: Array) -> SensorNoise:
    """The same with its most likely scale: a few steps of expectation maximisation."""
    unit = square.length / (noise.variance(speed) / noise.sigma**2)
    numbers = square.flat()[1]
    size = _sizes(np.array([noise.freedom]), unit.reshape(1, -1), numbers, np.array([noise.sigma]))
    return replace(noise, sigma=float(size[0]))


def _sizes(freedom: Array, unit: Array, numbers: Array, start: Array) -> Array:
    """(n,) most likely scales of n shapes, whose squares over σ² = 1 are unit (n, N) or (1, N), of
    numbers (N,)."""
    whole = float(numbers.sum())
    sigma = np.sqrt(np.sum(unit, axis=1) / whole) * np.ones(len(freedom))
    tailed = np.flatnonzero(np.isfinite(freedom))
    sigma[tailed] = start[tailed]
    for _ in range(12):
        if not len(tailed):
            break
        nu, own = freedom[tailed], unit if len(unit) == 1 else unit[tailed]
        before = sigma[tailed]
        heavy = own / (nu[:, None] + own / before[:, None] ** 2)
        sigma[tailed] = np.sqrt((nu * np.sum(heavy, axis=1) + heavy @ numbers) / whole)
        tailed = tailed[np.abs(sigma[tailed] / before - 1.0) >= 1e-3]
    return np.asarray(sigma)


def _levels(freedom: Array, unit: Array, square: Squares, base: Array, sigma: Array) -> Array:
    """(n,) log densities of n shapes at those scales; base : (n,) or (1,) sums of the logarithms of
    the variances over σ², one for each number."""
    from scipy.special import gammaln

    (samples, triads), (_, numbers) = square.length.shape, square.flat()
    flat = ~np.isfinite(freedom)
    nu = np.where(flat, 1.0, freedom)
    whole = 0.5 * base + square.count * np.log(sigma)
    d = unit / sigma[:, None] ** 2
    level = samples * gammaln(0.5 * (nu[:, None] + square.numbers)).sum(axis=1)
    level -= samples * triads * gammaln(0.5 * nu) + 0.5 * square.count * np.log(nu * np.pi)
    far = np.log1p(d / nu[:, None])
    tails = level - 0.5 * (nu * np.sum(far, axis=1) + far @ numbers)
    plain = -0.5 * np.sum(d, axis=1) - 0.5 * square.count * np.log(2.0 * np.pi)
    return np.asarray(np.where(flat, plain, tails) - whole)


def _best(options: list[SensorNoise], square: Squares, speed: Array) -> SensorNoise:
    """The most likely of shapes that differ in tails or in growth, each at its best scale."""
    alike = all(o.growth == options[0].growth for o in options)
    shown = options[:1] if alike else options
    relative = np.stack([(o.variance(speed) / o.sigma**2).ravel() for o in shown])
    length, numbers = square.flat()
    unit = length / relative
    freedom = np.array([o.freedom for o in options])
    sigma = _sizes(freedom, unit, numbers, np.array([o.sigma for o in options]))
    levels = _levels(freedom, unit, square, np.log(relative) @ numbers, sigma)
    best = int(np.argmax(levels))
    return replace(options[best], sigma=float(sigma[best]))


def fitted_noise(
    square: Squares, speed: Array, *, growth: bool, tails: bool, each: bool = False
) -> SensorNoise:
    """Most likely noise of residuals, of the shapes allowed."""
    noise = _shaped(_plain(square, speed), square, speed, growth=growth, tails=tails)
    return _of_each(noise, square, speed) if each else noise


def _plain(square: Squares, speed: Array) -> SensorNoise:
    start = float(np.sqrt(np.median(square.length / square.numbers)))
    noise = SensorNoise(max(start, 1e-12), 0.0, np.inf, np.ones(len(square.numbers)))
    return scaled(noise, square, speed)


def _shaped(
    noise: SensorNoise, square: Squares, speed: Array, *, growth: bool, tails: bool
) -> SensorNoise:
    unit = 1.0 / max(float(np.median(speed)), 1e-9)
    for _ in range(2 if growth and tails else 1):
        if growth:
            noise = _best(
                [noise, *(replace(noise, growth=g * unit) for g in _GROWTH)], square, speed
            )
        if tails:
            noise = _best([noise, *(replace(noise, freedom=nu) for nu in _NU)], square, speed)
    return noise


def _of_each(noise: SensorNoise, square: Squares, speed: Array) -> SensorNoise:
    return replace(noise, factor=np.sqrt(power_of_each(noise, square, speed)))


def power_of_each(noise: SensorNoise, square: Squares, speed: Array) -> Array:
    """(K,) mean weighted square of one number of each triad: one where the noise is as stated."""
    d, nu = square.length / noise.variance(speed), noise.freedom
    heavy = d if not np.isfinite(nu) else (nu + square.numbers) / (nu + d) * d
    return np.asarray(np.mean(heavy, axis=0) / square.numbers)


def _every_shape(square: Squares, speed: Array) -> list[SensorNoise]:
    """The most likely noise of each of `_SHAPES`: what they share is fitted once."""
    plain = _plain(square, speed)
    found = []
    for growth in (False, True):
        for tails in (False, True):
            noise = _shaped(plain, square, speed, growth=growth, tails=tails)
            found += [noise, _of_each(noise, square, speed)]
    return found


#: Growth, tails and factors of each, in the order of `_every_shape`.
_SHAPES = [
    {"growth": g, "tails": t, "each": e}
    for g in (False, True)
    for t in (False, True)
    for e in (False, True)
]


def chosen_noise(square: Squares, speed: Array, first: Flags, *, robust: bool) -> SensorNoise:
    """The simplest shape that no other beats by `HELD_OUT_NATS` on held-out halves, both ways.

    first : (T,) which half each sample belongs to
    """
    if not robust or min(int(first.sum()), int((~first).sum())) < 10:
        return fitted_noise(square, speed, growth=False, tails=False)
    totals = np.zeros(len(_SHAPES))
    for one, two in ((first, ~first), (~first, first)):
        found = _every_shape(square[one], speed[one])
        totals += [float(log_density(n, square[two], speed[two]).sum()) for n in found]
    best, chosen = 0.0, _SHAPES[0]
    for shape, gain in zip(_SHAPES[1:], totals[1:] - totals[0], strict=True):
        if gain > best + HELD_OUT_NATS:
            best, chosen = float(gain), shape
    return replace(fitted_noise(square, speed, **chosen), gained=best)
