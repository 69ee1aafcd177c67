"""Chips that sample on their own clocks: the age of each reading beats against the bus.

A chip that refreshes its registers every span seconds and is read at another rate gives readings
whose age is a sawtooth of that span; its beat drifts slowly with temperature. In an array the
others show it: the deviation of one gyro from their mean, along dω/dt, over |dω/dt|².
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array_gyros import relative_gyros
from imucalib.calibrators.array_moving import Moving

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_BLOCK = 3.0  # s over which a beat's phase is held to be steady
_LINE = 30.0  # power of a spectral line over the spectrum's median from which it counts
_ROUNDS = 4


@dataclass(frozen=True)
class SampleAge:
    """age : (N, K) s about its mean; frequency : (K,) Hz of the beat, negative when the age falls
    with time, NaN for a gyro without one; span : s, of the sawtooth; line : (K,) power of
    the line over the spectrum's median"""

    age: Array
    frequency: Array
    span: float
    line: Array


def rate_slope(moving: Moving) -> Array:
    """(N, 3) rad/s², central difference of the gyros' mean; NaN beside a gap."""
    slope = np.full_like(moving.gyros.mean, np.nan)
    step = moving.t[2:] - moving.t[:-2]
    inner = (moving.gyros.mean[2:] - moving.gyros.mean[:-2]) / step[:, None]
    inner[step > 2.2 * moving.interval] = np.nan
    slope[1:-1] = inner
    return slope


def with_slope(moving: Moving, slope: Array) -> Index:
    """The informative samples whose two neighbours are informative as well."""
    flag = np.zeros(len(moving.t), dtype=np.bool_)
    flag[moving.good] = True
    near = flag & np.roll(flag, 1) & np.roll(flag, -1) & np.isfinite(slope).all(axis=1)
    return np.flatnonzero(near)


def deviations(moving: Moving) -> Array:
    """(N, K, 3) rad/s, corrected gyros less their mean."""
    inverse = np.linalg.inv(moving.gyros.gain)
    return np.asarray(np.einsum("kij,nkj->nki", inverse, moving.rate) - moving.gyros.mean[:, None])


def fit_sample_age(moving: Moving, rows: Index) -> SampleAge:
    """Sawtooth ages from the samples `rows`, for all samples."""
    triads, current = moving.gyros.triads, moving
    age = np.zeros((len(moving.t), triads))
    frequency, line, span = np.full(triads, np.nan), np.zeros(triads), 0.0
    for _ in range(_ROUNDS):
        slope = rate_slope(current)
        off = deviations(current) + age[:, :, None] * np.nan_to_num(slope)[:, None]
        waves = np.zeros_like(age)
        for k in range(triads):
            waves[:, k], frequency[k], line[k] = _wave(current.t, off[:, k], slope, rows)
        flat = np.nan_to_num(slope)[rows]
        basis = waves[rows] - waves[rows].mean(axis=1, keepdims=True)
        along = np.einsum("nki,ni->nk", off[rows] - off[rows].mean(axis=1, keepdims=True), flat)
        power = np.sum(flat**2, axis=1)
        span = float(np.sum(along * basis) / max(np.sum(power[:, None] * basis**2), 1e-300))
        age = span * waves
        current = without_age(moving, age, rows)
    return SampleAge(age, frequency, span, line)


def without_age(moving: Moving, age: Array, rows: Index) -> Moving:
    """The moving part with the gyros moved to one instant, and their comparison redone."""
    slope = np.nan_to_num(rate_slope(moving))
    moved = np.einsum("kij,nj->nki", moving.gyros.gain, slope) * age[:, :, None]
    rate = moving.rate - moved
    return replace(moving, rate=rate, gyros=relative_gyros(rate, rows))


def _wave(t: Array, off: Array, slope: Array, rows: Index) -> tuple[Array, float, float]:
    """Unit sawtooth (N,), signed frequency, and the line's power; zeros when there is no line."""
    step = float(np.median(np.diff(t)))
    at = np.round((t[rows] - t[rows[0]]) / step).astype(np.intp)
    series = np.zeros(int(at[-1]) + 1)
    series[at] = np.sum(off[rows] * slope[rows], axis=1)
    padded = 4 * len(series)
    spectrum = np.abs(np.fft.rfft(series, padded)) ** 2
    frequencies = np.fft.rfftfreq(padded, step)
    spectrum[frequencies < 0.02] = 0.0
    top = int(np.argmax(spectrum))
    line = float(spectrum[top] / max(float(np.median(spectrum)), 1e-300))
    if line < _LINE:
        return np.zeros(len(t)), float("nan"), line
    f = float(frequencies[top])
    turns = f * t + _phase(t, t[rows], series[at], f) / (2.0 * np.pi)
    power = np.sum(slope[rows] ** 2, axis=1)
    best = (np.zeros(len(t)), f, -np.inf)
    for sign in (1.0, -1.0):
        # Both directions share the fundamental; the harmonics tell them apart.
        wave = _sharpened(t, turns - 0.25 * sign, sign, rows, series[at], power)
        explained = float(np.sum(wave[rows] * series[at]))
        gain = explained * abs(explained) / float(np.sum(power * wave[rows] ** 2))
        if gain > best[2]:
            best = (wave, sign * f, gain)
    return best[0], best[1], line


def _sawtooth(turns: Array) -> Array:
    return np.asarray(turns - np.floor(turns) - 0.5)


def _sharpened(
    t: Array, turns: Array, sign: float, rows: Index, series: Array, power: Array
) -> Array:
    """The sawtooth with its phase moved, block by block, to where its edges fit best."""
    at = t[rows]
    shifts = np.linspace(-0.15, 0.15, 25)
    waves = sign * _sawtooth(turns[rows] + shifts[:, None])
    span = max(float(np.sum(waves[12] * series) / np.sum(power * waves[12] ** 2)), 0.0)
    gains = span * waves * series - 0.5 * span**2 * power * waves**2
    centres = np.arange(at[0], at[-1] + _BLOCK, 0.5 * _BLOCK)
    totals = np.array([gains[:, np.abs(at - c) < 0.5 * _BLOCK].sum(axis=1) for c in centres])
    smooth = totals + 0.5 * (np.roll(totals, 1, axis=0) + np.roll(totals, -1, axis=0))
    chosen = shifts[np.argmax(smooth, axis=1)]
    return sign * _sawtooth(turns + np.interp(t, centres, chosen))


def _phase(t: Array, at: Array, series: Array, f: float) -> Array:
    """(N,) phase of the line, from blocks of a few seconds, joined smoothly."""
    turned = series * np.exp(-2j * np.pi * f * at)
    centres = np.arange(at[0], at[-1] + _BLOCK, 0.5 * _BLOCK)
    sums = np.array([turned[np.abs(at - c) < 0.5 * _BLOCK].sum() for c in centres])
    smooth = np.convolve(np.pad(sums, 1, mode="edge"), [0.5, 1.0, 0.5], mode="valid")
    return np.asarray(np.interp(t, centres, np.unwrap(np.angle(smooth))))
