"""Still segments of a recording and the noise of each triad, from one pass over the samples.

A window is still when, on every axis of every sensor, its variance and its range are what that
sensor's own noise explains. Neighbouring still windows join, their ends are found to the sample
where the samples are at hand, and what is still for all sensors is judged as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.recording.recording import HeldSamples, Recording
from imucalib.recording.sensors import undecided
from imucalib.rests.candidates import Candidate, candidates_of
from imucalib.rests.spans import SensorView
from imucalib.rests.stillness import Sensor, StillSettings
from imucalib.rests.windows import KeptSamples, WindowBuilder, Windows, usable_windows

_SHORTER = "record longer, or state a shorter rest with --shortest-rest"
# Acceleration takes part in any unit; an angular rate or a temperature without a scale cannot.
_UNITS = {"acceleration": "", "angular_rate": "rad/s", "temperature": "degC"}

#: Share of a mean's own variance that what a copy differs by has at most, and the fewest rests.
_COPIED, _FEWEST = 0.25, 4


@dataclass(frozen=True)
class Segments:
    """n still segments of K triads, in order of time.

    start, stop : (n,) s since the recording's start, of the first and last sample
    triads : K names, the order of every second axis
    spans : n of K of sample indices (first, last) in each triad's acceleration channel, last
        exclusive: what is quiet of the segment, several where single samples are loud
    samples : (n, K) samples of them
    mean : (n, K, 3) acceleration, m/s² (or counts)
    rate : (n, K, 3) mean angular rate, rad/s; NaN without a gyroscope
    temperature : (n, K) mean temperature, °C; NaN without a thermometer
    noise : (K, 3) standard deviation of one acceleration sample at rest
    rate_noise : (K, 3) the same of the angular rate; NaN without a gyroscope
    step, rate_step : (K, 3) resolution of both, 0 where it is not known
    notes : what was left out, one sentence each
    candidates : everything that may have been a rest, with what refused it
    """

    start: Array
    stop: Array
    triads: tuple[str, ...]
    spans: tuple[tuple[tuple[tuple[int, int], ...], ...], ...]
    samples: Index
    mean: Array
    rate: Array
    temperature: Array
    noise: Array
    rate_noise: Array
    step: Array
    rate_step: Array
    notes: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()

    @property
    def n(self) -> int:
        """Number of segments."""
        return int(self.start.size)

    @property
    def middle(self) -> Array:
        """(n,) s, of each segment."""
        return 0.5 * (self.start + self.stop)

    def copies(self) -> dict[str, str]:
        """Triads that repeat another one's readings, with a constant added or filtered, and which:
        the noisiest of a chip, which is the raw one. Two chips never agree better than the noise
        of one of them alone."""
        found: dict[str, str] = {}
        raw: list[int] = []
        for k in np.argsort(-self.noise.mean(axis=1), kind="stable") if self.n >= _FEWEST else ():
            for j in raw:
                apart = (self.mean[:, k] - self.mean[:, j]).var(axis=0)
                alone = self.noise[j] ** 2 * (1.0 / self.samples[:, j]).mean()
                if np.all(apart <= _COPIED * alone):
                    found[self.triads[k]] = self.triads[j]
                    break
            else:
                raw.append(int(k))
        return found

    def means(self, values: Array, k: int) -> Array:
        """(n, 3) mean of samples (N, 3) of triad number `k` at each segment."""
        quiet = (np.concatenate([values[a:b] for a, b in rest[k]]) for rest in self.spans)
        return np.array([samples.mean(axis=0) for samples in quiet]).reshape(-1, 3)


def still_segments(recording: Recording, settings: StillSettings | None = None) -> Segments:
    """The still segments of a whole recording; see `find_segments`."""
    return find_segments([recording], settings)


def find_segments(blocks: Iterable[Recording], settings: StillSettings | None = None) -> Segments:
    """The still segments of a recording given in blocks, as `readers.blocks` yields them.

    Every triad with acceleration takes part, and its gyroscope if that has a scale; a rest is
    one of all of them. The ends are to the sample as long as the blocks hold fewer numbers than
    `windows.KEPT`, else to the window. Raises UsageError when there is no acceleration,
    Undetermined when the recording is shorter than one window.
    """
    passed = _Pass(settings or StillSettings())
    for block in blocks:
        passed.add(block)
    every, notes = passed.seen()
    if not every:
        raise undecided((), "", passed.path)
    notes += [note for one in every for note in one.kinds.notes]
    candidates, more = candidates_of(every)
    rests = [c for c in candidates if not c.reason]
    if not passed.samples.whole:
        window = passed.settings.window
        more += (f"too long for ends to the sample: those of rests are at {window:g} s",)
    measured = _measure(rests, every, passed.temperatures())
    more += tuple(
        f"{copy} repeats {raw}, filtered or with a constant added: one chip; {raw} has all of it"
        for copy, raw in measured.copies().items()
    )
    return replace(measured, candidates=candidates, notes=(*notes, *more))


class _Pass:
    """What one pass over the blocks keeps: windows of all channels, and samples if few enough."""

    def __init__(self, settings: StillSettings) -> None:
        self.settings, self.path, self.samples = settings, "", KeptSamples()
        self._builders: dict[tuple[str, str], WindowBuilder] = {}
        self._rates: dict[tuple[str, str], float] = {}
        self._held: list[HeldSamples] = []

    def add(self, block: Recording) -> None:
        self.path = block.path
        self.samples.begin_block(block.gaps)
        self._held += block.held
        for channel in block.channels.values():
            key = (channel.quantity, channel.triad)
            if _UNITS.get(channel.quantity) not in (channel.unit, ""):
                continue
            if key not in self._builders:
                count = self.settings.samples(channel.rate)
                count = 1 if channel.quantity == "temperature" and channel.rate < 2 else count
                self._builders[key], self._rates[key] = WindowBuilder(count), channel.rate
            self._builders[key].add(channel, block.gaps)
            if channel.quantity != "temperature":
                self.samples.add(key, channel)

    def temperatures(self) -> dict[str, Windows]:
        found = {t: b.windows() for (q, t), b in self._builders.items() if q == "temperature"}
        return {triad: windows for triad, windows in found.items() if windows is not None}

    def seen(self) -> tuple[list[SensorView], list[str]]:
        """Accelerometers and their gyroscopes, and what was left out of them."""
        every, notes = [], list[str]()
        for (quantity, triad), builder in self._builders.items():
            if quantity == "temperature" or ("acceleration", triad) not in self._builders:
                continue
            name, rate = f"{triad}/{quantity}", self._rates[quantity, triad]
            ordered, lost = usable_windows(builder, self._held, name, self.path, _SHORTER)
            every.append(
                SensorView(Sensor(triad, quantity, rate, ordered, self.settings), self.samples)
            )
            if lost:
                seconds = lost * builder.samples / rate
                notes.append(f"{name}: {seconds:.4g} s left out: time had stepped back")
        return every, notes


def _measure(
    rests: list[Candidate], every: list[SensorView], temperatures: Mapping[str, Windows]
) -> Segments:
    triads = tuple(dict.fromkeys(one.sensor.triad for one in every))
    n, k = len(rests), len(triads)
    spans: list[list[tuple[tuple[int, int], ...]]] = [[()] * k for _ in rests]
    mean, rate = np.full((n, k, 3), np.nan), np.full((n, k, 3), np.nan)
    temperature = np.full((n, k), np.nan)
    noise, rate_noise = np.full((k, 3), np.nan), np.full((k, 3), np.nan)
    step, rate_step = np.zeros((k, 3)), np.zeros((k, 3))
    for one in every:
        sensor, at = one.sensor, triads.index(one.sensor.triad)
        (rate_noise if sensor.turns else noise)[at] = sensor.noise
        (rate_step if sensor.turns else step)[at] = sensor.step
        for i, rest in enumerate(rests):
            quiet = one.quiet_in((rest.start, rest.stop))
            (rate if sensor.turns else mean)[i, at] = one.mean(quiet)
            if not sensor.turns:
                spans[i][at] = tuple((span.first, span.last) for span in quiet)
    counted = [sum(b - a for a, b in own) for rest in spans for own in rest]
    samples = np.array(counted, dtype=np.intp).reshape(n, k)
    middle = np.array([0.5 * (rest.start + rest.stop) for rest in rests])
    for triad, windows in temperatures.items():
        if triad in triads:
            warm = np.interp(middle, windows.middle, windows.mean[:, 0])
            temperature[:, triads.index(triad)] = warm
    return Segments(
        start=np.array([rest.start for rest in rests]),
        stop=np.array([rest.stop for rest in rests]),
        triads=triads,
        spans=tuple(tuple(rest) for rest in spans),
        samples=samples,
        mean=mean,
        rate=rate,
        temperature=temperature,
        noise=noise,
        rate_noise=rate_noise,
        step=step,
        rate_step=rate_step,
    )
