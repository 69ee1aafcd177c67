"""The gyros' own clocks in the log that is fused: its beats, found window by window.

A calibration says how far a reading's age swings (its span); when, every log shows by itself where
it moves.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.fused.fuse import fuse
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.noise import ChipNoise
from imucalib.calibrators.array.fused.start import turning
from imucalib.calibrators.array.fused.stretch import Stretch
from imucalib.estimators.array.sample_age import fit_sample_age

_ROWS = 4096  # samples that are fused at a time, so that memory stays small
_WINDOW = 90.0  # s over which a beat holds its frequency
_FEWEST = 200  # moving samples of a window from which its beats are sought
_ROUGH = 2  # rounds of a first look


def ages(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> Array | None:
    """(T, K) unit sawtooths of the readings' ages, NaN where a gyro shows no beat; None where the
    calibration knows of none."""
    if instrument.beyond.span <= 0.0 or len(instrument.triads) < 3:
        return None
    found = np.full(stretch.rate.shape[:2], np.nan)
    t = stretch.t
    windows = max(1, round((t[-1] - t[0]) / _WINDOW))
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], windows + 1)[1:-1])
    for rows in np.split(np.arange(len(t)), edges):
        if len(rows) >= _FEWEST:
            part = slice(int(rows[0]), int(rows[-1]) + 1)
            found[part] = _of_window(instrument, stretch.take(part), noise)
    return found


def _of_window(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> Array:
    """(T, K) of one window."""
    off, spin, moving = _rough(instrument, stretch, noise)
    rows = np.flatnonzero(moving)
    if len(rows) < _FEWEST:
        return np.full(stretch.rate.shape[:2], np.nan)
    clock = fit_sample_age(stretch.t, off, spin, rows)
    return np.where(np.isfinite(clock.frequency), clock.wave, np.nan)


def _rough(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> tuple[Array, Array, Flags]:
    """(T, K, 3) gyros less their mean in board axes, (T, 3) dω/dt, and which samples move with all
    of their gyros in range. Only what may move is fused."""
    t, k, _ = stretch.rate.shape
    off, spin = np.zeros((t, k, 3)), np.zeros((t, 3))
    moving = np.zeros(t, dtype=np.bool_)
    fast = np.flatnonzero(turning(instrument, stretch))
    back = np.linalg.inv(instrument.gyro_axes)
    for start in range(0, len(fast), _ROWS):
        rows = fast[start : start + _ROWS]
        one = fuse(instrument, stretch.take(rows), noise, rounds=_ROUGH, tied=False)
        board = np.einsum("kai,tki->tka", back, one.rate_off, optimize=True)
        seen = np.all(one.rate_live, axis=2)
        board = np.where(seen[..., None], board, 0.0)
        mean = board.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
        off[rows] = np.where(seen[..., None], board - mean[:, None], 0.0)
        spin[rows] = one.motion.spin
        there = np.all(np.isfinite(stretch.rate[rows]), axis=2)
        moving[rows] = np.all(seen | ~there, axis=1) & np.any(seen, axis=1)
    return off, spin, moving
