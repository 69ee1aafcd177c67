"""Biases of a log's IMUs from its own rests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imucalib.arrays import Array
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
