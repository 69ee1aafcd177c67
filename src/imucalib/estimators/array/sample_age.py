"""Chips that sample on their own clocks: the age of each reading beats against the bus.

A chip that refreshes its registers every span seconds and is read at another rate gives readings
whose age is a sawtooth of that span; its beat drifts slowly with temperature. In an array the
others show it: a reading of age a is off by -a dω/dt, so the deviation of one gyro from their mean
along -dω/dt, over |dω/dt|², is its age. With x = -off · dω/dt and w = |dω/dt|² a sample, an age a
explains Σ a x - a² w / 2; all sums below are of this kind, over the samples that are learned from.
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
#: Turns by which a block's edges may leave the line, both ways, and how many are tried between,
#: the middle one none.
_REACH, _STEPS = 0.15, 25


@dataclass(frozen=True)
class SampleAge:
    """wave : (N, K) sawtooths of unit span about zero, zero for a gyro without a beat; the age is
    its span, s and positive, times this
    frequency : (K,) Hz of the beat, negative when the age falls with time, NaN without one"""

    wave: Array
    frequency: Array


def fit_sample_age(t: Array, off: Array, slope: Array, rows: Index) -> SampleAge:
    """Sawtooth ages for all samples, from the samples `rows`.

    t : (N,) s, rising, at an even pace but for gaps
    off : (N, K, 3) rad/s, gyros less their mean
    slope : (N, 3) dω/dt, rad/s²
    rows : (n,) samples that are learned from, rising

    Of each gyro, by itself: the line of largest power of x less a delay and its drift, in a
    spectrum padded fourfold; none where it is slower than _CYCLES over the samples or below _LINE
    times the spectrum's median, slower lines counted as zeros. Its phase follows the line in
    blocks; a rising and a falling sawtooth, whose fundamental is in phase with it, are each fitted
    to x, and the one that explains more stays.
    """
    found = [_fit_wave(t, -one, slope, rows) for one in off.swapaxes(0, 1)]
    return SampleAge(np.stack([wave for wave, _ in found], axis=1), np.array([f for _, f in found]))


def _fit_wave(t: Array, late: Array, slope: Array, rows: Index) -> tuple[Array, float]:
    """Unit sawtooth (N,) and signed frequency of a gyro that lags by `late` (N, 3); zeros and NaN
    when there is no line."""
    along = np.sum(late[rows] * slope[rows], axis=1)
    power = np.sum(slope[rows] ** 2, axis=1)
    beyond = _without_delay(t[rows], along, power, np.zeros((len(rows), 0)))
    f = _find_line(t[rows], beyond, float(np.median(np.diff(t))))
    if not np.isfinite(f):
        return np.zeros(len(t)), f
    turns = f * t + _phase(t, t[rows], beyond, f) / (2.0 * np.pi)
    # Both directions share the fundamental; the harmonics tell them apart.
    found = [(*_fit_edges(t, turns - 0.25 * s, s, rows, along, power), s * f) for s in (1.0, -1.0)]
    wave, _, signed = max(found, key=lambda one: one[1])
    return wave, signed


def _find_line(at: Array, series: Array, step: float) -> float:
    """Hz of the strongest line of a series at times `at` (n,), zero between them on a grid of
    `step` s; NaN without one."""
    grid = np.round((at - at[0]) / step).astype(np.intp)
    even = np.zeros(int(grid[-1]) + 1)
    even[grid] = series
    padded = 4 * len(even)
    spectrum = np.abs(np.fft.rfft(even, padded)) ** 2
    frequencies = np.fft.rfftfreq(padded, step)
    spectrum[frequencies < _CYCLES / (at[-1] - at[0])] = 0.0
    top = int(np.argmax(spectrum))
    if spectrum[top] < _LINE * max(float(np.median(spectrum)), 1e-300):
        return float("nan")
    return float(frequencies[top])


def _without_delay(at: Array, along: Array, power: Array, waves: Array) -> Array:
    """x (n,) less a delay of the gyro's own and its drift: no beat.

    at : (n,) s; along : (n,) x; power : (n,) w
    waves : (n, m) ages that are fitted beside, and stay in what is left
    """
    delays = (at - at.mean())[:, None] ** np.arange(2)
    columns = np.hstack([waves, delays])
    found = np.linalg.solve(columns.T @ (columns * power[:, None]), columns.T @ along)
    return np.asarray(along - power * (delays @ found[waves.shape[1] :]))


def _fit_edges(
    t: Array, turns: Array, sign: float, rows: Index, along: Array, power: Array
) -> tuple[Array, float]:
    """A sawtooth (N,) with its phase where it fits best, and how much it explains: (Σ a x)² / Σ a²
    w, with the sign of Σ a x. A slow one is partly a delay and its drift: these are fitted with it,
    and the phase is sought again, from the turns (N,) of the line.

    sign : 1 where the age rises with the turns, -1 where it falls
    """
    own = turns
    for _ in range(_PASSES):
        wave = sign * _sawtooth(own[rows])
        series = _without_delay(t[rows], along, power, wave[:, None])
        own = turns + _shift_blocks(t, turns, sign, rows, series, power)
    wave = sign * _sawtooth(own)
    explained = float(np.sum(wave[rows] * series))
    return wave, explained * abs(explained) / float(np.sum(power * wave[rows] ** 2))


def _sawtooth(turns: Array) -> Array:
    """From -1/2 to 1/2 over each turn; 0 at the half."""
    return np.asarray(turns - np.floor(turns) - 0.5)


def _shift_blocks(
    t: Array, turns: Array, sign: float, rows: Index, series: Array, power: Array
) -> Array:
    """(N,) turns by which a sawtooth's edges fit better, straight between the centres of blocks.

    Blocks of _BLOCK s overlap by half, from the first sample; in each the shift of those tried that
    explains most, at one span for all, that of the unshifted wave, which is never below 0.
    """
    at = t[rows]
    shifts = np.linspace(-_REACH, _REACH, _STEPS)
    waves = sign * _sawtooth(turns[rows] + shifts[:, None])
    middle = waves[_STEPS // 2]
    span = max(float(np.sum(middle * series) / np.sum(power * middle**2)), 0.0)
    gains = span * waves * series - 0.5 * span**2 * power * waves**2
    centres = _centres(at)
    ends = np.searchsorted(at, np.concatenate([centres - 0.5 * _BLOCK, centres + 0.5 * _BLOCK]))
    whole = np.concatenate([np.zeros((_STEPS, 1)), np.cumsum(gains, axis=1)], axis=1)[:, ends]
    chosen = _at_peak(shifts, (whole[:, len(centres) :] - whole[:, : len(centres)]).T)
    return np.asarray(np.interp(t, centres, chosen))


def _centres(at: Array) -> Array:
    return np.arange(at[0], at[-1] + _BLOCK, 0.5 * _BLOCK)


def _at_peak(shifts: Array, gains: Array) -> Array:
    """(n,) where gains (n, m) of evenly spaced shifts (m,) are largest: the top of the parabola
    through the largest and its neighbours, at most a step from it; at an end, that of the three
    last."""
    top = np.clip(np.argmax(gains, axis=1), 1, len(shifts) - 2)
    low, middle, high = (gains[np.arange(len(top)), top + k] for k in (-1, 0, 1))
    bend = np.maximum(2.0 * middle - low - high, 1e-300)
    away = np.clip(0.5 * (high - low) / bend, -1.0, 1.0)
    return np.asarray(shifts[top] + away * (shifts[1] - shifts[0]))


def _phase(t: Array, at: Array, series: Array, f: float) -> Array:
    """(N,) rad by which the line at f Hz leads exp(2 pi i f t): of blocks as those of the edges,
    each smoothed with its neighbours by (1/2, 1, 1/2), straight between their centres."""
    turned = series * np.exp(-2j * np.pi * f * at)
    centres = _centres(at)
    sums = np.array([turned[np.abs(at - c) < 0.5 * _BLOCK].sum() for c in centres])
    smooth = np.convolve(np.pad(sums, 1, mode="edge"), [0.5, 1.0, 0.5], mode="valid")
    return np.asarray(np.interp(t, centres, np.unwrap(np.angle(smooth))))
