"""How the chips scatter about the fused motion: as at rest, and more the faster they turn.

An axis has variance σ_i² + (c f_k |ω|)², its triad the tails of a Student t of ν degrees of freedom
where these are likelier. c, f and ν come from the log itself: what a calibration leaves differs
with the motion, and the stated covariance stands on it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.fused.instrument import Biases, Instrument
from imucalib.calibrators.array.gyros import ATTITUDES, contradicted
from imucalib.calibrators.array.loop.motion import BoardMotion, motion_at_rest
from imucalib.rests.segments import Segments

_WANDER, _REST = 1e-2, 2e-3  # m/s²: what biases do from log to log, and one rest's own error
_MOST = 200  # groups of rests, at most
#: Variance that a bias walks in the mean time between rests over what differs from rest to rest.
_SHARES = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 26)])


def biases_at_rest(segments: Segments, order: dict[int, int], instrument: Instrument) -> Biases:
    """What corrected readings hold at the rests.

    A rest shows every gyro's bias, and what accelerometers differ by; what all of them share would
    hang on the place's gravity. The calibration's biases count as one more value of them.
    """
    acceleration, rate = means_at_rest(segments, order, instrument)
    middle = 0.5 * (segments.start + segments.stop)
    force, turned = instrument.corrected(middle, acceleration, rate)
    there = np.all(np.isfinite(acceleration), axis=2)
    turning = np.all(np.isfinite(rate), axis=2)
    mean = (force * there[..., None]).sum(axis=1) / there.sum(axis=1)[:, None]
    apart = np.where(there[..., None], force - mean[:, None], 0.0)
    known = segments.n / (segments.n + (_REST / _WANDER) ** 2)
    turned = turned - instrument.beyond.added(_at_rest(instrument, mean))[1]
    turned = np.where(turning[..., None], turned, 0.0)
    return Biases(known * apart.mean(axis=0), *_over_time(segments, middle, turned))


def held_against(segments: Segments, order: dict[int, int], instrument: Instrument) -> Instrument:
    """Without gyro effects of the force that the rests contradict: an effect found in motion may
    stand for something else there, and gravity in other attitudes shows whether it is one of force.
    """
    acceleration, rate = means_at_rest(segments, order, instrument)
    middle = 0.5 * (segments.start + segments.stop)
    force, turned = instrument.corrected(middle, acceleration, rate)
    there = np.all(np.isfinite(acceleration) & np.isfinite(rate), axis=2)
    whole = there.all(axis=0)
    if segments.n < ATTITUDES or not whole.any():
        return instrument
    motion = _at_rest(instrument, force[:, whole].mean(axis=1))
    wrong = [
        part.term.name
        for part in instrument.beyond.parts
        if part.gyro
        and not part.late
        and contradicted(turned[:, whole], part.added(motion)[:, whole])
    ]
    if not wrong:
        return instrument
    return replace(instrument, beyond=instrument.beyond.without(wrong))


def means_at_rest(
    segments: Segments, order: dict[int, int], instrument: Instrument
) -> tuple[Array, Array]:
    """(n, K, 3) acceleration and rate of the rests as read; NaN of an IMU that is not there."""
    shape = (segments.n, len(instrument.triads), 3)
    acceleration, rate = np.full(shape, np.nan), np.full(shape, np.nan)
    for k, column in order.items():
        acceleration[:, k], rate[:, k] = segments.mean[:, column], segments.rate[:, column]
    return acceleration, rate


def _at_rest(instrument: Instrument, force: Array) -> BoardMotion:
    """The board at rest under forces (n, 3)."""
    each = np.repeat(force[:, None], len(instrument.triads), axis=1)
    t = np.arange(float(len(force)))
    return motion_at_rest(instrument.imus, instrument.beyond.rotations, each, t)


def _over_time(segments: Segments, middle: Array, turned: Array) -> tuple[Array, Array]:
    """Times (m,) s and biases (m, K, 3) rad/s of the gyros.

    A rest's mean also holds what its attitude does to a gyro, which is no drift: the biases walk,
    rests scatter about them, and the likeliest ratio of the two (restricted likelihood, all axes
    together) says how far the walk is believed.
    """
    length = np.maximum(segments.stop - segments.start, 1e-3)
    size = -(-len(length) // _MOST)
    group = np.arange(len(length)) // size
    weight = np.bincount(group, length)
    at = np.bincount(group, length * middle) / weight
    y = np.zeros((len(weight), turned[0].size))
    np.add.at(y, group, turned.reshape(len(turned), -1) * length[:, None])
    y /= weight[:, None]
    n, shape = len(at), turned.shape[1:]
    if n < 3:
        return at, y.reshape(n, *shape)
    walk = np.minimum(at[:, None], at) - at[0]
    walk /= float(np.mean(np.diff(at)))
    best, found = -np.inf, y
    for share in _SHARES:
        inverse = np.linalg.inv(np.eye(n) + share * walk)
        total = float(inverse.sum())
        mean = inverse.sum(axis=0) @ y / total
        off = y - mean
        square = float(np.sum(off * (inverse @ off)))
        free, axes = y.shape[1] * (n - 1), y.shape[1]
        level = axes * (np.linalg.slogdet(inverse)[1] - np.log(total))
        density = 0.5 * (level - free * np.log(max(square, 1e-300)))
        if density > best:
            best, found = density, mean + share * walk @ (inverse @ off)
    return at, np.asarray(found.reshape(n, *shape))


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


def fitted_noise(off: Array, live: Flags, left: Array, speed: Array, rest: Array) -> ChipNoise:
    """The likeliest noise of residuals.

    off : (T, K, 3) along the sensors' axes; live : (T, K, 3); left : (T, K) share of a triad's
    variance that the motion has not taken; speed : (T,) rad/s; rest : (K, 3)
    """
    square = np.where(live, off**2, 0.0) / np.maximum(left, _LEFT)[..., None]
    fast = float(np.sqrt(np.mean(speed**2))) or 1.0
    unit = float(np.sqrt(np.mean(rest**2))) / fast
    found, best = at_rest(rest), -np.inf
    for nu in _NU:
        tried = [replace(found, growth=np.full(len(rest), c * unit), freedom=nu) for c in _GROWTH]
        values = [_density(noise, square, live, speed) for noise in tried]
        top = int(np.argmax(values))
        if values[top] > best + _LEAST:
            found, best = tried[top], values[top]
    each = _each(found, square, live, speed)
    return each if _density(each, square, live, speed) > best + _LEAST * len(rest) else found


def _each(noise: ChipNoise, square: Array, live: Flags, speed: Array) -> ChipNoise:
    """With the growth of every IMU by itself."""
    factors = np.concatenate([[0.0], np.geomspace(0.4, 2.5, 25)])
    values = np.array(
        [_of_triads(replace(noise, growth=noise.growth * f), square, live, speed) for f in factors]
    )
    return replace(noise, growth=noise.growth * factors[np.argmax(values, axis=0)])


def _density(noise: ChipNoise, square: Array, live: Flags, speed: Array) -> float:
    return float(_of_triads(noise, square, live, speed).sum())


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
