"""Readings of a thermometer that none has made: jumps that no case can follow, and come back.

A thermometer that has just been powered reads 85 °C, one that does not answer -127 °C between good
readings (DS18B20, data sheet, Maxim 2019). The case of a sensor takes minutes: what differs from
the readings of a minute around it by more than the case can change, and is gone after it, is no
temperature. There is none there then: what was read at rest meanwhile has no temperature.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.rests.windows import COLUMNS, Windows

_RANGE = (-55.0, 125.0)  # °C that common thermometers can read
_FASTEST = 0.2  # °C/s: a case of one minute's time constant, moved by 12 °C at once
_LEAST, _MOST = 2.0, 30.0  # °C that a jump has at least; that it always is
_AROUND, _FEWEST, _WIDEST = 50.0, 2, 5  # s on either side that it is held against, and windows
_NOISE = 8.0  # standard deviations (by the median)
_STEPS = 1.5  # steps of the resolution
_CODES = (85.0, -127.0)  # °C that it says after power-up, and where it does not answer
_HALF = 0.5  # share of jumps from which on nothing of a thermometer is believed


@dataclass(frozen=True)
class Believed:
    """windows : without the jumps, None where too few are left; gone : (k, 2) s, from and to of
    those; words : how many, or nothing"""

    windows: Windows | None
    gone: Array = field(default_factory=lambda: np.empty((0, 2)))
    words: tuple[str, ...] = ()


def believed(w: Windows | None) -> Believed:
    """The windows of a thermometer, if there is one, that hold no jump."""
    if w is None or not (bad := _jumps(w)).any():
        return Believed(w)
    count = f"{int(bad.sum())} of {bad.size} readings"
    why = "that jump and come back faster than a case can, or that are none"
    if bad.mean() > _HALF:
        return Believed(None, words=(f"temperature: not used, for {count} are {why}",))
    kept = replace(w, **{name: getattr(w, name)[~bad] for name in COLUMNS})
    half = 0.5 * _interval(w)
    middle = 0.5 * (w.start + w.stop)[bad]
    own = 0.5 * (w.stop - w.start)[bad]
    reach = np.maximum(own, half)
    gone = np.column_stack([middle - reach, middle + reach])
    return Believed(kept, gone, (f"temperature: {count} left out {why}",))


def temperature_in(w: Windows | None, gone: Array, start: Array, stop: Array) -> Array:
    """(n,) °C in the middle of intervals (n,) s; NaN in those that hold a reading that is gone, and
    without a thermometer."""
    if w is None:
        return np.full(start.size, np.nan)
    middle = 0.5 * (start + stop)
    found = np.interp(middle, 0.5 * (w.start + w.stop), w.mean[:, 0])
    found[is_gone(gone, middle)] = np.nan
    return np.asarray(found)


def is_gone(gone: Array, at: Array) -> Flags:
    """(n,) whether times (s) are within what a thermometer did not measure, (k, 2) s in order."""
    last = np.searchsorted(gone[:, 0], at, side="right") - 1
    return np.asarray((last >= 0) & (at < np.append(gone[:, 1], -np.inf)[last]))


def mean_of_known(values: Array, starts: Index) -> Array:
    """(k,) means of the finite values of stretches that begin at `starts`; NaN where none is."""
    known = np.isfinite(values)
    count = np.add.reduceat(known.astype(np.float64), starts)
    total = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.asarray(np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan))


def tells_apart(w: Windows, one: Array, other: Array) -> bool:
    """Whether two temperatures (n,) °C, made of a thermometer's readings, differ by more than its
    rounding makes them differ: by twice its error of step / √12, in the root mean square."""
    step = float(w.finest[0]) if np.isfinite(w.finest[0]) else _step(w.mean[:, 0])
    return float(np.mean(np.square(one - other))) > step**2 / 3.0


def told_by_code(values: Array) -> Flags:
    """(n,) whether a reading of a table, °C, is what a thermometer says that has not measured: just
    that number, not in two rows that follow each other, and far from the rows that measured."""
    code = np.isin(values, _CODES)
    others = values[~code]
    if others.size <= _HALF * values.size or (code[1:] & code[:-1]).any():
        return np.zeros_like(code)
    return np.asarray(code & (np.abs(values[:, None] - others).min(axis=1) > _MOST))


def _jumps(w: Windows) -> Flags:
    low, high = w.low[:, 0], w.high[:, 0]
    bad = ~(np.isfinite(w.mean[:, 0]) & (low >= _RANGE[0]) & (high <= _RANGE[1]))
    good = np.flatnonzero(~bad)
    interval = _interval(w)
    half = int(np.clip(round(_AROUND / interval), _FEWEST, _WIDEST))
    if good.size <= 2 * half:
        return bad
    around = _medians(w.mean[good, 0], half)
    off = np.maximum(high[good] - around, around - low[good])
    limit = max(
        float(np.clip(_FASTEST * interval, _LEAST, _MOST)),
        _NOISE * 1.4826 * float(np.median(off)),
        _STEPS * _step(w.mean[good, 0]),
    )
    bad[good] = off > limit
    return bad


def _interval(w: Windows) -> float:
    """s from window to window."""
    return float(np.median(np.diff(w.start))) if w.start.size > 1 else 1.0


def _medians(values: Array, half: int) -> Array:
    """(n,) median of every value with `half` on either side, mirrored at the ends."""
    padded = np.pad(values, half, mode="reflect")
    return np.asarray(
        np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    )


def _step(values: Array) -> float:
    """°C, the smallest difference of two readings."""
    apart = np.diff(np.unique(values))
    return float(apart.min()) if apart.size else 0.0
