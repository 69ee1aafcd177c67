"""How the noise of an array's sensors is distributed: its size, growth with the rate, and tails.

A triad's residual of one sample is a three-dimensional Student t of scale σ(ω), with
σ(ω)² = σ² f_k² (1 + (c |ω|)²) and ν degrees of freedom (infinite: Gaussian). Growth, tails and a
factor of one IMU are taken in only when held-out blocks of time gain by them. The t acts as weights
(ν + 3)/(ν + d²) on the samples (Lange, Little, Taylor 1989, JASA 84).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags

_NU = (3.0, 4.0, 6.0, 10.0, 25.0)
_GROWTH = (0.3, 0.7, 1.5, 3.0, 7.0, 20.0)
HELD_OUT_NATS = 4.0


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
        return self.growth == 0.0 and not np.isfinite(self.freedom) and bool(
            np.all(self.factor == 1.0)
        )  # fmt: skip


def log_density(noise: SensorNoise, square: Array, speed: Array) -> Array:
    """(T, K) log density of residual vectors of squared lengths `square`."""
    from scipy.special import gammaln

    variance = noise.variance(speed)
    d, nu = square / variance, noise.freedom
    if not np.isfinite(nu):
        return np.asarray(-0.5 * d - 1.5 * np.log(2.0 * np.pi * variance))
    level = gammaln(0.5 * (nu + 3.0)) - gammaln(0.5 * nu) - 1.5 * np.log(nu * np.pi)
    return np.asarray(level - 1.5 * np.log(variance) - 0.5 * (nu + 3.0) * np.log1p(d / nu))


def scaled(noise: SensorNoise, square: Array, speed: Array) -> SensorNoise:
    """The same with its most likely scale: a few steps of expectation maximisation."""
    unit = square / (noise.variance(speed) / noise.sigma**2)
    if not np.isfinite(noise.freedom):
        return replace(noise, sigma=float(np.sqrt(np.mean(unit) / 3.0)))
    sigma, nu = noise.sigma, noise.freedom
    for _ in range(12):
        before, heavy = sigma, unit / (nu + unit / sigma**2)
        sigma = float(np.sqrt((nu + 3.0) * np.mean(heavy) / 3.0))
        if abs(sigma / before - 1.0) < 1e-3:
            break
    return replace(noise, sigma=sigma)


def _best(options: list[SensorNoise], square: Array, speed: Array) -> SensorNoise:
    fitted = [scaled(option, square, speed) for option in options]
    values = [float(log_density(f, square, speed).sum()) for f in fitted]
    return fitted[int(np.argmax(values))]


def fitted_noise(
    square: Array, speed: Array, *, growth: bool, tails: bool, each: bool = False
) -> SensorNoise:
    """Most likely noise of residuals with squared lengths (T, K), of the shapes allowed."""
    unit = 1.0 / max(float(np.median(speed)), 1e-9)
    start = float(np.sqrt(np.median(square) / 2.366))
    noise = scaled(
        SensorNoise(max(start, 1e-12), 0.0, np.inf, np.ones(square.shape[1])), square, speed
    )
    for _ in range(2 if growth and tails else 1):
        if growth:
            noise = _best([noise, *(replace(noise, growth=g * unit) for g in _GROWTH)],
                          square, speed)  # fmt: skip
        if tails:
            noise = _best([noise, *(replace(noise, freedom=nu) for nu in _NU)], square, speed)
    if each:
        d = square / noise.variance(speed)
        weight = noise.weight(square, speed) * noise.variance(speed)
        noise = replace(noise, factor=np.sqrt(np.mean(weight * d, axis=0) / 3.0))
    return noise


def chosen_noise(square: Array, speed: Array, first: Flags, *, robust: bool) -> SensorNoise:
    """The simplest shape that no other beats by `HELD_OUT_NATS` on held-out halves, both ways.

    first : (T,) which half each sample belongs to
    """
    plain = fitted_noise(square, speed, growth=False, tails=False)
    if not robust or min(int(first.sum()), int((~first).sum())) < 10:
        return plain
    shapes = [{"growth": g, "tails": t, "each": e}
              for g in (False, True) for t in (False, True) for e in (False, True)]  # fmt: skip
    base, best, chosen = _held_out(square, speed, first, shapes[0]), 0.0, shapes[0]
    for shape in shapes[1:]:
        gain = _held_out(square, speed, first, shape) - base
        if gain > best + HELD_OUT_NATS:
            best, chosen = gain, shape
    return replace(fitted_noise(square, speed, **chosen), gained=best)


def _held_out(square: Array, speed: Array, first: Flags, shape: dict[str, bool]) -> float:
    total = 0.0
    for one, two in ((first, ~first), (~first, first)):
        noise = fitted_noise(square[one], speed[one], **shape)
        total += float(log_density(noise, square[two], speed[two]).sum())
    return total
