"""The temperature over a recording, at any time, and what a lag or a play makes of it.

For these it is kept as means of ten seconds, which a week has sixty thousand of: the lag of a
whole recording costs the same memory however the recording is read.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.thermometer import believed, is_gone
from imucalib.rests.windows import WindowBuilder, Windows, in_order

_WINDOW = 10.0  # s
_FORGOTTEN = 20.0  # decays
_SILENT = 3600.0  # s without a reading after which nothing is known of the way to the next one


@dataclass(frozen=True)
class ThermalHistory:
    """time (m,) s, of the middles of the windows; values (m,) °C, their means; gone : (k, 2) s, in
    order, from and to of what the thermometer did not measure."""

    time: Array
    values: Array
    gone: Array = field(default_factory=lambda: np.empty((0, 2)))

    def lagged(self, hours: float, at: Array) -> Array:
        """Temperature (°C) behind a lag of some hours, at times (s); it starts in equilibrium."""
        t = self.time
        step = float(np.median(np.diff(t))) if t.size > 1 else 1.0
        grid = np.arange(t[0], t[-1] + step, step)
        values = np.interp(grid, t, self.values)
        share = 1.0 - np.exp(-step / (3600.0 * hours))
        return np.asarray(np.interp(at, grid, _trailing(values, share)))

    def rate(self, hours: float, at: Array) -> Array:
        """How fast the temperature changes (°C/h), over a lag of some hours, at times (s)."""
        now = np.interp(at, self.time, self.values)
        return np.asarray((now - self.lagged(hours, at)) / hours)

    def behind_play(self, width: float, at: Array) -> Array:
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
    """y_k = y_{k-1} + share (x_k - y_{k-1}) from equilibrium, in stretches over which a reading's
    weight falls to e^-20: in sums the decay is a factor, and there none overflows."""
    if share >= 1.0:
        return values
    decay = -np.log1p(-share)
    found, last = np.empty_like(values), values[0]
    length = max(1, int(_FORGOTTEN / decay))
    for start in range(0, values.size, length):
        some = values[start : start + length]
        fallen = np.exp(-decay * np.arange(1, some.size + 1))
        found[start : start + length] = fallen * (last + np.cumsum(share * some / fallen))
        last = found[start + some.size - 1]
    return found


def history_of(windows: Windows) -> ThermalHistory:
    """From the windows of a temperature channel."""
    return ThermalHistory(0.5 * (windows.start + windows.stop), windows.mean[:, 0])


def thermal_history(blocks: Iterable[Recording], triad: str) -> ThermalHistory | None:
    """From a recording in blocks, of the thermometer of a triad; None when there is none. Jumps
    that no case can follow are left out; where more than half are jumps, all is gone."""
    builder: WindowBuilder | None = None
    for block in blocks:
        for channel in block.channels.values():
            if channel.quantity == "temperature" and channel.triad in (triad, ""):
                builder = builder or WindowBuilder(max(1, round(_WINDOW * channel.rate)))
                builder.add(channel, block.gaps)
                break
    windows = builder.windows() if builder else None
    if windows is None:
        return None
    heat = believed(in_order(windows)[0])
    if heat.windows is None:
        return ThermalHistory(np.empty(0), np.empty(0), np.array([[-np.inf, np.inf]]))
    return replace(history_of(heat.windows), gone=heat.gone)


def thermometer_of(recording: Recording, triad: str) -> Channel | None:
    """The temperature channel of a triad, or the one that belongs to none."""
    for channel in recording.channels.values():
        if channel.quantity == "temperature" and channel.triad in (triad, ""):
            return channel
    return None


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


def unheard(thermometer: Channel, history: ThermalHistory, at: Array) -> Flags:
    """(n,) whether there is no temperature at times (s): at a reading that is gone, and between it
    and its neighbours."""
    t, bad = thermometer.t, is_gone(history.gone, thermometer.t)
    after = np.minimum(np.searchsorted(t, at), t.size - 1)
    before = np.maximum(np.searchsorted(t, at, side="right") - 1, 0)
    return np.asarray(bad[after] | bad[before])


def with_thermometer(
    blocks: Iterable[Recording], triad: str
) -> Iterator[tuple[Recording, Channel | None]]:
    """Every block with the readings around it: the last one before it and the first one after.

    A block waits for that one, an hour of the recording at most, so that a slow thermometer gives
    the same temperatures in blocks of any size.
    """
    waiting: deque[tuple[Recording, float]] = deque()
    track: Channel | None = None
    seen = start = -np.inf
    for block in blocks:
        new = thermometer_of(block, triad)
        track = _joined(track, new) if new is not None else track
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
                near = max(int(np.searchsorted(track.t, end, side="right")) - 1, 0)
                track = replace(track, t=track.t[near:], values=track.values[near:])
    for block, _ in waiting:
        yield block, track


def _joined(before: Channel | None, new: Channel) -> Channel:
    if before is None:
        return new
    t, values = np.concatenate([before.t, new.t]), np.concatenate([before.values, new.values])
    return replace(new, t=t, values=values)
