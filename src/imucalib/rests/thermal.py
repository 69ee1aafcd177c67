"""The temperature over a recording, at any time, and what a lag or a play makes of it.

For these it is kept as means of ten seconds, which a week has sixty thousand of: the lag of a
whole recording costs the same memory however the recording is read.

Readings that no thermometer has made are left out. One that has just been powered reads 85 °C, one
that does not answer -127 °C between good readings (DS18B20, data sheet, Maxim 2019). The case of a
sensor takes minutes: what differs from the readings of a minute around it by more than the case can
change, and is gone after it, is no temperature. There is none there then: what was read at rest
meanwhile has no temperature.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_banded

from imucalib.arrays import Array, Flags, Index
from imucalib.effects.thermal import LAG, PLAY, RATE, ROWS
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.windows import WindowBuilder, Windows, in_order

_RANGE = (-55.0, 125.0)  # °C that common thermometers can read
_FASTEST = 0.2  # °C/s: a case of one minute's time constant, moved by 12 °C at once
_LEAST, _MOST = 2.0, 30.0  # °C that a jump has at least; that it always is
_AROUND, _FEWEST, _WIDEST = 50.0, 2, 5  # s on either side that it is held against, and windows
_NOISE = 8.0  # standard deviations (by the median)
_STEPS = 1.5  # steps of the resolution
_CODES = (85.0, -127.0)  # °C that it says after power-up, and where it does not answer
_HALF = 0.5  # share of jumps from which on nothing of a thermometer is believed
_WINDOW = 10.0  # s
_SILENT = 3600.0  # s without a reading after which nothing is known of the way to the next one
#: Covariates that a recording with a clock and a thermometer has.
REMEMBERED = tuple(past.covariate(value) for past in (LAG, PLAY, RATE) for value in past.values)
#: Power that the temperature itself shows of what is made of it, from which on it is that: a play's
#: noise, and a lag's change within a recording beside recordings at temperatures of their own.
_PLAIN = {PLAY.prefix: 0.97, LAG.prefix: 0.999}


def believable_windows(w: Windows | None) -> tuple[ThermalHistory | None, tuple[str, ...]]:
    """What windows of a thermometer, if there is one, tell in order of time without those that hold
    a jump; None where more than half do. How many those are, in words, or nothing.

    Gone is a window's length, or the time from one to the next where that is longer, about its
    middle; the resolution is that of the samples, of means where each window is one sample.
    """
    if w is None:
        return None, ()
    w, _ = in_order(w)
    bad, gone = _jumps(w), np.empty((0, 2))
    words: tuple[str, ...] = ()
    if bad.any():
        count = f"{int(bad.sum())} of {bad.size} readings"
        why = "that jump and come back faster than a case can, or that are none"
        if bad.mean() > _HALF:
            return None, (f"temperature: not used, for {count} are {why}",)
        words = (f"temperature: {count} left out {why}",)
        reach = np.maximum(0.5 * (w.stop - w.start), 0.5 * _interval(w))
        gone = np.column_stack([w.middle - reach, w.middle + reach])[bad]
        w = w.take(~bad)
    step = float(w.finest[0]) if np.isfinite(w.finest[0]) else _step(w.mean[:, 0])
    return ThermalHistory(w.middle, w.mean[:, 0], gone, step), words


def is_gone(gone: Array, at: Array) -> Flags:
    """(n,) whether times (s) are within what a thermometer did not measure, (k, 2) s in order: from
    the first of two to before the second."""
    last = np.searchsorted(gone[:, 0], at, side="right") - 1
    return np.asarray((last >= 0) & (at < np.append(gone[:, 1], -np.inf)[last]))


def mean_of_known(values: Array, starts: Index) -> Array:
    """(k,) means of the finite values of stretches that begin at `starts`; NaN where none is."""
    known = np.isfinite(values)
    count = np.add.reduceat(known.astype(np.float64), starts)
    total = np.add.reduceat(np.where(known, values, 0.0), starts)
    return np.asarray(np.where(count > 0.0, total / np.maximum(count, 1.0), np.nan))


def is_power_up_code(values: Array) -> Flags:
    """(n,) whether a reading of a table, °C, is what a thermometer says that has not measured: just
    that number, far from every row that measured. None is where half of the rows say it, or any
    two that follow each other, by whatever codes."""
    code = np.isin(values, _CODES)
    others = values[~code]
    if others.size <= _HALF * values.size or (code[1:] & code[:-1]).any():
        return np.zeros_like(code)
    return np.asarray(code & (np.abs(values[:, None] - others).min(axis=1) > _MOST))


def _jumps(w: Windows) -> Flags:
    """(m,) whether a window holds a jump: a reading that is none or beyond `_RANGE`, or one farther
    from the median of the means around it, of good windows alone, than the largest of what a case
    changes from window to window, of the noise of these distances, and of steps of the means. Where
    that many good ones are not there, nothing is held against them."""
    from scipy.ndimage import median_filter

    low, high = w.low[:, 0], w.high[:, 0]
    bad = ~(np.isfinite(w.mean[:, 0]) & (low >= _RANGE[0]) & (high <= _RANGE[1]))
    good = np.flatnonzero(~bad)
    interval = _interval(w)
    half = int(np.clip(round(_AROUND / interval), _FEWEST, _WIDEST))
    if good.size <= 2 * half:
        return bad
    around = median_filter(w.mean[good, 0], 2 * half + 1, mode="mirror")
    off = np.maximum(high[good] - around, around - low[good])
    limit = max(
        float(np.clip(_FASTEST * interval, _LEAST, _MOST)),
        _NOISE * 1.4826 * float(np.median(off)),
        _STEPS * _step(w.mean[good, 0]),
    )
    bad[good] = off > limit
    return bad


def _interval(w: Windows) -> float:
    """s from window to window, the median; of one alone 1 s."""
    return float(np.median(np.diff(w.start))) if w.start.size > 1 else 1.0


def _step(values: Array) -> float:
    """°C, the smallest difference of two readings."""
    apart = np.diff(np.unique(values))
    return float(apart.min()) if apart.size else 0.0


@dataclass(frozen=True)
class ThermalHistory:
    """time (m,) s, of the middles of the windows; values (m,) °C, their means; gone : (k, 2) s, in
    order, from and to of what the thermometer did not measure; step : °C, its resolution."""

    time: Array
    values: Array
    gone: Array = field(default_factory=lambda: np.empty((0, 2)))
    step: float = 0.0

    def temperature(self, at: Array) -> Array:
        """(n,) °C at times (s); NaN where a reading is gone. What is made of it below goes through
        that, straight from reading to reading."""
        found = np.interp(at, self.time, self.values)
        return np.where(is_gone(self.gone, at), np.nan, found)

    def shows(self, one: Array, other: Array) -> bool:
        """Whether two temperatures (n,) °C, made of these, differ by more than the thermometer's
        rounding makes them: by twice its error of step / √12, in the root mean square."""
        return float(np.mean(np.square(one - other))) > self.step**2 / 3.0

    def lagged(self, hours: float, at: Array) -> Array:
        """Temperature (°C) behind a lag of some hours, at times (s); it starts in equilibrium, and
        goes on in steps of the usual time between windows where some are missing."""
        t = self.time
        step = float(np.median(np.diff(t))) if t.size > 1 else 1.0
        grid = np.arange(t[0], t[-1] + step, step)
        values = np.interp(grid, t, self.values)
        share = 1.0 - np.exp(-step / (3600.0 * hours))
        return np.asarray(np.interp(at, grid, _trailing(values, share)))

    def rate(self, hours: float, at: Array) -> Array:
        """How fast the temperature changes (°C/h), at times (s): what it is ahead of a lag of some
        hours, an hour."""
        now = np.interp(at, self.time, self.values)
        return np.asarray((now - self.lagged(hours, at)) / hours)

    def within_play(self, width: float, at: Array) -> Array:
        """Temperature (°C) behind a play of a width (°C), in the middle of it at the start, at
        times (s)."""
        return np.asarray(np.interp(at, self.time, _with_play(self.values, width)))


def _with_play(values: Array, width: float) -> Array:
    """p_k = p_{k-1} held to x_k ± width / 2. To hold to one range after another is to hold to one:
    the ranges of 1, 2, 4, ... steps come from those of half as many."""
    low, high = values - 0.5 * width, values + 0.5 * width
    low[:1] = high[:1] = values[:1]
    step = 1
    while step < values.size:
        before = low[:-step], high[:-step]
        first, last = (np.clip(x, low[step:], high[step:]) for x in before)
        low, high = np.append(low[:step], first), np.append(high[:step], last)
        step *= 2
    return low


def _trailing(values: Array, share: float) -> Array:
    """y_k = y_{k-1} + share (x_k - y_{k-1}) from equilibrium, as one system of equations."""
    own, before = np.ones(values.size), np.full(values.size, share - 1.0)
    right = share * values
    right[0] = values[0]
    return np.asarray(solve_banded((1, 0), np.stack([own, before]), right))


def thermal_history(blocks: Iterable[Recording], triad: str) -> ThermalHistory | None:
    """From a recording in blocks, of the thermometer of a triad; None when there is none. Jumps
    that no case can follow are left out; where more than half are jumps, nothing is there and all
    times are gone."""
    builder: WindowBuilder | None = None
    for block in blocks:
        if (channel := thermometer_of(block, triad)) is not None:
            builder = builder or WindowBuilder(max(1, round(_WINDOW * channel.rate)))
            builder.add(channel, block.gaps)
    windows = builder.windows() if builder else None
    if windows is None:
        return None
    found, _ = believable_windows(windows)
    everything = np.array([[-np.inf, np.inf]])
    return found or ThermalHistory(np.empty(0), np.empty(0), everything)


def thermometer_of(recording: Recording, triad: str) -> Channel | None:
    """The temperature channel of a triad, or the one that belongs to none."""
    each = [c for c in recording.channels.values() if c.quantity == "temperature"]
    return next((c for owner in (triad, "") for c in each if c.triad == owner), None)


def temperature_at(thermometer: Channel, at: Array) -> Array:
    """Temperature (°C) at times (s), straight from reading to reading.

    Where readings are more than an hour apart the earlier one holds, as at the end.
    """
    t, values = thermometer.t, thermometer.values[:, 0]
    found = np.interp(at, t, values)
    if not np.any(np.diff(t) > _SILENT):
        return np.asarray(found)
    before = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    alone = (at >= t[before]) & (at < t[before + 1]) & (t[before + 1] - t[before] > _SILENT)
    return np.where(alone, values[before], found)


def lacks_temperature(thermometer: Channel, history: ThermalHistory, at: Array) -> Flags:
    """(n,) whether there is no temperature at times (s): at a reading that is gone, and between it
    and its neighbours."""
    t, bad = thermometer.t, is_gone(history.gone, thermometer.t)
    after = np.minimum(np.searchsorted(t, at), t.size - 1)
    before = np.maximum(np.searchsorted(t, at, side="right") - 1, 0)
    return np.asarray(bad[after] | bad[before])


def pair_thermometer(
    blocks: Iterable[Recording], triad: str
) -> Iterator[tuple[Recording, Channel | None]]:
    """Every block with the readings around it: its own, the last one before it, and the first one
    after its last acceleration, unless one is at that time; later ones may come along.

    A block waits for that one, so that a slow thermometer gives the same temperatures in blocks of
    any size; not where for an hour, of the readings or else of the recording, there was none.
    """
    waiting: deque[tuple[Recording, float]] = deque()
    track: Channel | None = None
    seen = start = -np.inf
    for block in blocks:
        new = thermometer_of(block, triad)
        if new is not None and track is not None:
            t = np.concatenate([track.t, new.t])
            new = replace(new, t=t, values=np.concatenate([track.values, new.values]))
        track = track if new is None else new
        times = [c.t[-1] for c in block.channels.values() if c.quantity == "acceleration"]
        seen = max([seen, *map(float, times)])
        start = start if np.isfinite(start) else seen
        waiting.append((block, seen))
        heard = -np.inf if track is None else float(track.t[-1])
        silent = seen > max(heard, start) + _SILENT
        while waiting and (waiting[0][1] <= heard or silent):
            first, end = waiting.popleft()
            yield first, track
            if track is not None:  # from the last reading before the next block on
                first_kept = max(int(np.searchsorted(track.t, end, side="right")) - 1, 0)
                track = replace(track, t=track.t[first_kept:], values=track.values[first_kept:])
    for block, _ in waiting:
        yield block, track


def is_remembered(name: str) -> bool:
    """Whether a history of the temperature gives the covariate; it knows of no rows."""
    return name.startswith((LAG.prefix, PLAY.prefix, RATE.prefix)) and not name.endswith(ROWS)


def remember(history: ThermalHistory, name: str, at: Array) -> Array:
    """The covariate (°C) at times (s)."""
    of = {LAG: history.lagged, PLAY: history.within_play, RATE: history.rate}
    past = next(past for past in of if name.startswith(past.prefix))
    return of[past](past.size(name.removeprefix(past.prefix)), at)


def remember_in_rows(temperature: Array, time: Array | None, session: Array) -> dict[str, Array]:
    """Covariates (n,) of a table: lags of `LAG.rows` rows where it has four times as many, rates of
    `RATE.rows`, and plays of half its range of temperature and less: on one way alone, or between
    two of them, a play is an offset. With a clock (s) rows are the median times between them, and
    named in hours or minutes to two digits. Each session (n,) begins in equilibrium, amid the play.
    Nothing where the clock stands, nor what is plainly the temperature."""
    at = 3600.0 * np.arange(len(temperature)) if time is None else time
    every = float(np.median(np.abs(np.diff(at)))) / 3600.0
    if every <= 0.0:
        return {}
    sizes: dict[str, tuple[Callable[[ThermalHistory, float, Array], Array], float]] = {}
    for rows in (r for r in LAG.rows if 4 * r <= len(temperature)):
        value = f"{rows}{ROWS}" if time is None else f"{rows * every:.2g}h"
        sizes[LAG.covariate(value)] = ThermalHistory.lagged, rows * every
    for rows in RATE.rows:
        value = f"{rows}{ROWS}" if time is None else f"{60.0 * rows * every:.2g}min"
        sizes[RATE.covariate(value)] = ThermalHistory.rate, rows * every
    for value in PLAY.values:
        if 2.0 * PLAY.size(value) <= np.ptp(temperature):
            sizes[PLAY.covariate(value)] = ThermalHistory.within_play, PLAY.size(value)
    found = {name: np.empty(len(temperature)) for name in sizes}
    for one in np.unique(session):
        of = session == one
        history = ThermalHistory(at[of], temperature[of])
        for name, (course, size) in sizes.items():
            found[name][of] = course(history, size, at[of])
    return {name: v for name, v in found.items() if not _is_plain(name, v, temperature)}


def _is_plain(name: str, values: Array, temperature: Array) -> bool:
    """Whether what follows the temperature is no more than it, a scale and an offset; a rate never
    is."""
    most = next((p for prefix, p in _PLAIN.items() if name.startswith(prefix)), np.inf)
    spread = float(np.std(values))
    same = spread <= 0.0 or float(np.corrcoef(values, temperature)[0, 1] ** 2) >= most
    return bool(np.isfinite(most)) and same
