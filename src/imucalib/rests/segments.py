"""Still segments of a recording and the noise of each triad, from one pass over the samples.

A window is still when, on every axis of every sensor, its variance and its range are what that
sensor's own noise explains; the noise is measured on the quietest windows of the recording.
Neighbouring still windows join while their means agree, so a slow turn is not a rest.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.errors import Undetermined, UsageError
from imucalib.recording.recording import Recording
from imucalib.rests.stillness import Sensor, StillSettings, judge
from imucalib.rests.windows import WindowBuilder, Windows, in_order

__all__ = ["Segments", "StillSettings", "find_segments", "still_segments"]


# Acceleration takes part in any unit; an angular rate or a temperature without a scale cannot.
_UNITS = {"acceleration": "", "angular_rate": "rad/s", "temperature": "degC"}


@dataclass(frozen=True)
class Segments:
    """n still segments of K triads, in order of time.

    start, stop : (n,) s since the recording's start, of the first and last sample
    triads : K names, the order of every second axis
    first, last : (n, K) sample indices in each triad's acceleration channel; last is exclusive
    samples : (n, K) samples
    mean, variance : (n, K, 3) acceleration, m/s² and (m/s²)² (or counts), pooled over windows
    rate : (n, K, 3) mean angular rate, rad/s; NaN without a gyroscope
    temperature : (n, K) mean temperature, °C; NaN without a thermometer
    noise : (K, 3) standard deviation of one acceleration sample at rest
    rate_noise : (K, 3) the same of the angular rate; NaN without a gyroscope
    moving : share of the recording's windows that are not still
    notes : what was left out, one sentence each
    """

    start: Array
    stop: Array
    triads: tuple[str, ...]
    first: Index
    last: Index
    samples: Index
    mean: Array
    variance: Array
    rate: Array
    temperature: Array
    noise: Array
    rate_noise: Array
    moving: float
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of segments."""
        return int(self.start.size)


def still_segments(recording: Recording, settings: StillSettings | None = None) -> Segments:
    """The still segments of a whole recording; see `find_segments`."""
    return find_segments([recording], settings)


def find_segments(blocks: Iterable[Recording], settings: StillSettings | None = None) -> Segments:
    """The still segments of a recording given in blocks, as `readers.blocks` yields them.

    Every triad with acceleration takes part, and its gyroscope if that has a scale; a rest is
    one of all of them. Raises UsageError when there is no acceleration, Undetermined when
    the recording is shorter than one window.
    """
    chosen = settings or StillSettings()
    sensors, temperatures, path, notes = _collect(blocks, chosen)
    triads = tuple(dict.fromkeys(s.triad for s in sensors))
    spans: list[tuple[float, float]] | None = None
    moving = []
    for sensor in sensors:
        found, still, remarks = judge(sensor, chosen)
        notes += remarks
        moving.append(1.0 - float(still.mean()))
        spans = found if spans is None else _intersect(spans, found)
    if spans is None:
        raise UsageError("the recording has no acceleration channel", where=path)
    lasting = [(a, b) for a, b in spans if b - a >= chosen.shortest]
    return _measure(lasting, triads, sensors, temperatures, moving=max(moving), notes=tuple(notes))


def _collect(
    blocks: Iterable[Recording], settings: StillSettings
) -> tuple[list[Sensor], dict[str, Windows], str, list[str]]:
    builders: dict[tuple[str, str], WindowBuilder] = {}
    rates: dict[tuple[str, str], float] = {}
    path = ""
    for block in blocks:
        path = block.path
        for channel in block.channels.values():
            key = (channel.quantity, channel.triad)
            if _UNITS.get(channel.quantity) not in (channel.unit, ""):
                continue
            if key not in builders:
                samples = max(settings.fewest, round(settings.window * channel.rate))
                samples = 1 if channel.quantity == "temperature" and channel.rate < 2 else samples
                builders[key], rates[key] = WindowBuilder(samples), channel.rate
            builders[key].add(channel, block.gaps)
    temperatures = {
        t: w for (q, t), b in builders.items() if q == "temperature" if (w := b.windows())
    }
    sensors, notes = [], list[str]()
    for (quantity, triad), builder in builders.items():
        if quantity == "temperature" or ("acceleration", triad) not in builders:
            continue
        sensor, lost = _sensor(builder, triad, quantity, rates[quantity, triad], path=path)
        sensors.append(sensor)
        notes += [lost] if lost else []
    return sensors, temperatures, path, notes


def _sensor(
    builder: WindowBuilder, triad: str, quantity: str, rate: float, *, path: str
) -> tuple[Sensor, str]:
    """The sensor's windows in order of time, and what that left out."""
    windows = builder.windows()
    if windows is None:
        raise Undetermined(
            f"{triad}/{quantity} has no {builder.samples} samples in a row without a gap",
            where=path,
            remedy="record longer, or choose a shorter window",
        )
    ordered, lost = in_order(windows)
    seconds = lost * windows.samples / rate
    note = f"{triad}/{quantity}: {seconds:.4g} s left out: time had stepped back" if lost else ""
    return Sensor(triad, quantity, rate, ordered), note


def _intersect(
    one: list[tuple[float, float]], two: list[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Common parts of two ordered lists of intervals."""
    out, i, j = [], 0, 0
    while i < len(one) and j < len(two):
        start, stop = max(one[i][0], two[j][0]), min(one[i][1], two[j][1])
        if stop > start:
            out.append((start, stop))
        if one[i][1] < two[j][1]:
            i += 1
        else:
            j += 1
    return out


def _measure(
    spans: list[tuple[float, float]], triads: tuple[str, ...], sensors: list[Sensor],
    temperatures: dict[str, Windows], *, moving: float, notes: tuple[str, ...],
) -> Segments:  # fmt: skip
    n, k = len(spans), len(triads)
    first, last = np.zeros((n, k), dtype=np.intp), np.zeros((n, k), dtype=np.intp)
    mean, variance = np.full((n, k, 3), np.nan), np.full((n, k, 3), np.nan)
    rate, temperature = np.full((n, k, 3), np.nan), np.full((n, k), np.nan)
    noise, rate_noise = np.full((k, 3), np.nan), np.full((k, 3), np.nan)
    for sensor in sensors:
        at = triads.index(sensor.triad)
        bounds = _bounds(sensor.windows, spans)
        if sensor.quantity == "angular_rate":
            rate[:, at] = _pooled(sensor.windows.mean, bounds)
            rate_noise[at] = sensor.noise
            continue
        noise[at] = sensor.noise
        mean[:, at] = _pooled(sensor.windows.mean, bounds)
        variance[:, at] = _pooled(sensor.windows.variance, bounds)
        ends = np.append(sensor.windows.first, 0)
        first[:, at] = ends[bounds[:, 0]]
        last[:, at] = sensor.windows.first[bounds[:, 1] - 1] + sensor.windows.samples
    for triad, windows in temperatures.items():
        for at in [i for i, name in enumerate(triads) if name == triad]:
            middle = 0.5 * (windows.start + windows.stop)
            at_span = np.array([0.5 * (a + b) for a, b in spans])
            temperature[:, at] = np.interp(at_span, middle, windows.mean[:, 0])
    keep = np.all(last > first, axis=1) if n else np.zeros(0, dtype=np.bool_)
    start, stop = np.array(spans).reshape(n, 2).T
    return Segments(
        start=start[keep],
        stop=stop[keep],
        triads=triads,
        first=first[keep],
        last=last[keep],
        samples=(last - first)[keep],
        mean=mean[keep],
        variance=variance[keep],
        rate=rate[keep],
        temperature=temperature[keep],
        noise=noise,
        rate_noise=rate_noise,
        moving=moving,
        notes=notes,
    )


def _bounds(windows: Windows, spans: list[tuple[float, float]]) -> NDArray[np.intp]:
    """(n, 2) range of the windows that lie wholly inside each span."""
    low = np.array([a for a, _ in spans])
    high = np.array([b for _, b in spans])
    a = np.searchsorted(windows.start, low, side="left")
    b = np.searchsorted(windows.stop, high, side="right")
    return np.stack([a, np.maximum(b, a)], axis=1).astype(np.intp)


def _pooled(values: Array, bounds: NDArray[np.intp]) -> Array:
    """Mean of the rows a..b of `values` for each (a, b); NaN where there is none."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    count = (bounds[:, 1] - bounds[:, 0])[:, None]
    with np.errstate(invalid="ignore"):
        pooled: Array = (total[bounds[:, 1]] - total[bounds[:, 0]]) / count
    return pooled
