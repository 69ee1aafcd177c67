"""The temperature over a recording, and what an exponential lag makes of it.

It is kept as means of ten seconds, which a week has sixty thousand of: the lag of a whole
recording costs the same memory however the recording is read.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from imucalib.recording import Array, Recording
from imucalib.windows import WindowBuilder, Windows, in_order

_WINDOW = 10.0  # s


@dataclass(frozen=True)
class ThermalHistory:
    """time (m,) s, of the middles of the windows; values (m,) °C, their means."""

    time: Array
    values: Array

    def lagged(self, hours: float, at: Array) -> Array:
        """Temperature (°C) behind a lag of some hours, at times (s); it starts in equilibrium."""
        from scipy.signal import lfilter

        t = self.time
        step = float(np.median(np.diff(t))) if t.size > 1 else 1.0
        grid = np.arange(t[0], t[-1] + step, step)
        values = np.interp(grid, t, self.values)
        share = 1.0 - np.exp(-step / (3600.0 * hours))
        late = lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0]
        return np.asarray(np.interp(at, grid, late))


def history_of(windows: Windows) -> ThermalHistory:
    """From the windows of a temperature channel."""
    return ThermalHistory(0.5 * (windows.start + windows.stop), windows.mean[:, 0])


def thermal_history(blocks: Iterable[Recording], triad: str) -> ThermalHistory | None:
    """From a recording in blocks, of the thermometer of a triad; None when there is none."""
    builder: WindowBuilder | None = None
    for block in blocks:
        for channel in block.channels.values():
            if channel.quantity == "temperature" and channel.triad in (triad, ""):
                builder = builder or WindowBuilder(max(1, round(_WINDOW * channel.rate)))
                builder.add(channel, block.gaps)
                break
    windows = builder.windows() if builder else None
    return history_of(in_order(windows)[0]) if windows else None
