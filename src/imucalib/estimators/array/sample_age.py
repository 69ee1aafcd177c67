"""Chips that sample on their own clocks: the age of each reading beats against the bus.

A chip that refreshes its registers every span seconds and is read at another rate gives readings
whose age is a sawtooth of that span; its beat drifts slowly with temperature. In an array the
others show it: the deviation of one gyro from their mean, along dω/dt, over |dω/dt|².
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index

#: s over which a beat's phase follows its line. Of four measured motions the gyros' held-out error
#: is 0.66 deg/s with 3 s, 0.56 with 12 s and 0.55 with 20 s.
_BLOCK = 12.0
_PASSES = 2  # of a phase and a delay in turn
_CYCLES = 4.0  # of a beat over the motion, below which it is a delay that drifts
_LINE = 30.0  # power of a spectral line over the spectrum's median from which it counts


@dataclass(frozen=True)
class SampleAge:
    """wave : (N, K) sawtooths of unit span about zero, zero for a gyro without a beat;
    frequency : (K,) Hz of the beat, negative when the age falls with time, NaN without one"""

    wave: Array
    frequency: Array


def fit_sample_age(t: Array, off: Array, slope: Array, rows: Index) -> SampleAge:
    """Sawtooth ages for all samples, from the samples `rows`.

    off : (N, K, 3) rad/s, gyros less their mean; slope : (N, 3) dω/dt, rad/s²
    """
    # A reading of age a is off by -a dω/dt.
    found = [_wave(t, -one, slope, rows) for one in off.swapaxes(0, 1)]
    return SampleAge(np.stack([wave for wave, _ in found], axis=1), np.array([f for _, f in found]))


def _wave(t: Array, off: Array, slope: Array, rows: Index) -> tuple[Array, float]:
    """Unit sawtooth (N,) and signed frequency; zeros and NaN when there is no line."""
    step = float(np.median(np.diff(t)))
    at = np.round((t[rows] - t[rows[0]]) / step).astype(np.intp)
    series = np.zeros(int(at[-1]) + 1)
    power = np.sum(slope[rows] ** 2, axis=1)
    late = _late(t[rows])
    along = np.sum(off[rows] * slope[rows], axis=1)
    delay = np.linalg.solve(late.T @ (late * power[:, None]), late.T @ along)
    series[at] = along - power * (late @ delay)
    padded = 4 * len(series)
    spectrum = np.abs(np.fft.rfft(series, padded)) ** 2
    frequencies = np.fft.rfftfreq(padded, step)
    spectrum[frequencies < _CYCLES / (t[rows[-1]] - t[rows[0]])] = 0.0
    top = int(np.argmax(spectrum))
    if spectrum[top] < _LINE * max(float(np.median(spectrum)), 1e-300):
        return np.zeros(len(t)), float("nan")
    f = float(frequencies[top])
    turns = f * t + _phase(t, t[rows], series[at], f) / (2.0 * np.pi)
    # Both directions share the fundamental; the harmonics tell them apart.
    found = [(*_settle(t, turns - 0.25 * s, s, rows, along, power), s * f) for s in (1.0, -1.0)]
    wave, _, signed = max(found, key=lambda one: one[1])
    return wave, signed


def _settle(
    t: Array, turns: Array, sign: float, rows: Index, along: Array, power: Array
) -> tuple[Array, float]:
    """A sawtooth with its phase where it fits best, and how much it explains. A slow one is partly
    a delay and its drift: these are fitted with it, and the phase is sought again."""
    own = turns
    for _ in range(_PASSES):
        wave = sign * _sawtooth(own[rows])
        columns = np.column_stack([wave, _late(t[rows])])
        inner = columns.T @ (columns * power[:, None])
        delay = np.linalg.solve(inner, columns.T @ along)[1:]
        series = along - power * (_late(t[rows]) @ delay)
        own = _sharpened(t, turns, sign, rows, series, power)
    wave = sign * _sawtooth(own)
    explained = float(np.sum(wave[rows] * series))
    return wave, explained * abs(explained) / float(np.sum(power * wave[rows] ** 2))


def _late(at: Array) -> Array:
    """(n, 2) a delay of the gyro's own, even one that drifts: no beat."""
    return np.asarray((at - at.mean())[:, None] ** np.arange(2))


def _sawtooth(turns: Array) -> Array:
    return np.asarray(turns - np.floor(turns) - 0.5)


def _sharpened(
    t: Array, turns: Array, sign: float, rows: Index, series: Array, power: Array
) -> Array:
    """The turns of a sawtooth moved, block by block, to where its edges fit best."""
    at = t[rows]
    shifts = np.linspace(-0.15, 0.15, 25)
    waves = sign * _sawtooth(turns[rows] + shifts[:, None])
    span = max(float(np.sum(waves[12] * series) / np.sum(power * waves[12] ** 2)), 0.0)
    gains = span * waves * series - 0.5 * span**2 * power * waves**2
    centres = np.arange(at[0], at[-1] + _BLOCK, 0.5 * _BLOCK)
    ends = np.searchsorted(at, np.concatenate([centres - 0.5 * _BLOCK, centres + 0.5 * _BLOCK]))
    whole = np.concatenate([np.zeros((len(shifts), 1)), np.cumsum(gains, axis=1)], axis=1)[:, ends]
    chosen = _at_peak(shifts, (whole[:, len(centres) :] - whole[:, : len(centres)]).T)
    return np.asarray(turns + np.interp(t, centres, chosen))


def _at_peak(shifts: Array, gains: Array) -> Array:
    """(n,) where gains (n, m) of evenly spaced shifts (m,) are largest: the top of the parabola
    through the largest and its neighbours."""
    top = np.clip(np.argmax(gains, axis=1), 1, len(shifts) - 2)
    low, middle, high = (gains[np.arange(len(top)), top + k] for k in (-1, 0, 1))
    bend = np.maximum(2.0 * middle - low - high, 1e-300)
    away = np.clip(0.5 * (high - low) / bend, -1.0, 1.0)
    return np.asarray(shifts[top] + away * (shifts[1] - shifts[0]))


def _phase(t: Array, at: Array, series: Array, f: float) -> Array:
    """(N,) phase of the line, from blocks of a few seconds, joined smoothly."""
    turned = series * np.exp(-2j * np.pi * f * at)
    centres = np.arange(at[0], at[-1] + _BLOCK, 0.5 * _BLOCK)
    sums = np.array([turned[np.abs(at - c) < 0.5 * _BLOCK].sum() for c in centres])
    smooth = np.convolve(np.pad(sums, 1, mode="edge"), [0.5, 1.0, 0.5], mode="valid")
    return np.asarray(np.interp(t, centres, np.unwrap(np.angle(smooth))))
