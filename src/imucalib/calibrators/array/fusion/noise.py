"""How the chips scatter about the fused motion: as at rest, and more the faster they turn.

An axis has variance σ_i² + (c f_k |ω|)², its triad the tails of a Student t of ν degrees of freedom
where these are likelier. c, f and ν come from the log itself: what a calibration leaves differs
with the motion, and the stated covariance stands on it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags

_NU = (np.inf, 25.0, 10.0, 6.0, 4.0, 3.0)
_GROWTH = np.concatenate([[0.0], np.geomspace(0.03, 30.0, 31)])
_GROSS = 30.0  # squared length in sigmas beyond which a Gaussian triad is no part of the sample
_LEAST = 4.0  # nats by which tails or one IMU's factor must win
_LEFT = 0.02  # least share of its variance that a residual keeps


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
    growth = _GROWTH * float(np.sqrt(np.mean(rest**2))) / fast
    found, best = at_rest(rest), -np.inf
    for nu in _NU:
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
    from scipy.special import gammaln

    variance, nu = noise.variance(speed), noise.freedom
    count = live.sum(axis=2)
    d = np.sum(square / variance, axis=2)
    level = -0.5 * np.sum(np.where(live, np.log(variance), 0.0), axis=2)
    if not np.isfinite(nu):
        return np.asarray((level - 0.5 * d - 0.5 * count * np.log(2.0 * np.pi)).sum(axis=0))
    level += gammaln(0.5 * (nu + count)) - gammaln(0.5 * nu) - 0.5 * count * np.log(nu * np.pi)
    return np.asarray((level - 0.5 * (nu + count) * np.log1p(d / nu)).sum(axis=0))
