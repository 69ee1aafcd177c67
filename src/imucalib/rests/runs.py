"""Posture runs: still windows of a worn sensor, grouped while the posture lasts.

Windows of one posture share what the posture does to the sensor, so a run of them is one
observation: its mean reading, time and temperature, and how many windows it averages.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.errors import Undetermined, UnreadableInput, UsageError
from imucalib.recording.recording import Channel, Held, Recording
from imucalib.rests.postures import postures_begin
from imucalib.rests.ranges import refuse_two_ranges
from imucalib.rests.stillness import Sensor, StillSettings, still_windows
from imucalib.rests.stuck import limits, stuck, without
from imucalib.rests.tails import TailBuilder, overlapping, with_tails
from imucalib.rests.thermometer import believed, mean_of_known, temperature_in
from imucalib.rests.windows import WindowBuilder, Windows, in_order, without_held
from imucalib.units import MG, STANDARD_GRAVITY

#: Of a worn sensor: ten-second windows, as the field uses, three axes, noise plus a sway of 3 mg
#: that breathing causes. Together they tilt the mean by less than 1e-5 of its size.
WORN = StillSettings(
    window=10.0, shortest=5.0, trim=0, variance_ratio=2.25, range_ratio=12.0, sway=3.3 * MG,
    quietest=0.05,
)  # fmt: skip


@dataclass(frozen=True)
class Scan:
    """What one pass over a recording leaves: windows of the accelerometer and the temperature.

    samples : of the accelerometer; rate : Hz; stop : s, time of the last sample
    no_temperature : (k, 2) s, from and to of what the thermometer did not measure
    """

    windows: Windows
    temperature: Windows | None
    triad: str
    rate: float
    samples: int
    stop: float
    gaps: int
    path: str
    format: str
    sha256: str
    start_ns: int | None
    notes: tuple[str, ...]
    mapping: Mapping[str, object] = field(default_factory=dict)
    no_temperature: Array = field(default_factory=lambda: np.empty((0, 2)))

    def without_windows(self) -> Scan:
        """The rest, once the runs are made: the windows are most of the memory."""
        arrays = ("first", "run", "start", "stop", "mean", "variance", "low", "high")
        nothing = {name: getattr(self.windows, name)[:0].copy() for name in arrays}
        return replace(self, windows=replace(self.windows, **nothing))


@dataclass(frozen=True)
class PostureRuns:
    """n runs in order of time.

    mean : (n, 3) m/s²; windows : (n,) how many; time : (n,) s, of the middle
    temperature : (n,) °C, or NaN; window_noise : m/s², scatter of one window's norm in its run
    still, total : windows that are still, and all; noise : (3,) m/s², of one sample at rest
    resolution : (3,) m/s², the smallest step between samples, 0 where it is not known
    faults : in words, axes that are stuck or at their limit at rest
    """

    mean: Array
    windows: Index
    time: Array
    temperature: Array
    window_noise: float
    still: int
    total: int
    noise: Array
    notes: tuple[str, ...] = ()
    resolution: Array = field(default_factory=lambda: np.zeros(3))
    faults: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        return int(self.time.size)


def scan(blocks: Iterable[Recording], window: float, triad: str | None = None) -> Scan:
    """One pass over a recording in blocks; memory is that of a block and of the windows.

    Raises UsageError when it is not clear which accelerometer, UnreadableInput when it has no
    scale, Undetermined when it is shorter than one window.
    """
    builders: dict[str, WindowBuilder] = {}
    tails: TailBuilder | None = None
    name, rate, samples, stop, gaps = "", 0.0, 0, 0.0, 0
    notes: list[str] = []
    held: list[Held] = []
    first: Recording | None = None
    for block in blocks:
        first = first or block
        notes += block.notes
        held += block.held
        gaps += len(block.gaps)
        if not name:
            name = _accelerometer(block, triad)
        for key, channel in _chosen(block, name):
            if key not in builders:
                per = max(1 if key == "temperature" else 5, round(window * channel.rate))
                builders[key] = WindowBuilder(per)
            builders[key].add(channel, block.gaps)
            if key == "acceleration":
                tails = tails or TailBuilder(max(5, round(WORN.shortest * channel.rate)))
                tails.add(channel, block.gaps)
                rate, samples = rate or channel.rate, samples + channel.t.size
                stop = max(stop, float(channel.t[-1])) if channel.t.size else stop
    if first is None or tails is None:
        where = first.path if first else ""
        raise UsageError(
            "the recording has no acceleration channel",
            where=where,
            remedy="`imucal inspect FILE` lists what it has; name the columns with --acc X,Y,Z",
        )
    windows = builders["acceleration"].windows()
    if windows is None:
        raise Undetermined(
            f"no {window:g} s in a row without a gap", where=first.path, remedy="record longer"
        )
    ordered, lost = in_order(windows)
    if lost:
        notes.append(f"{lost} windows left out: time had stepped back")
    held = [h for h in held if h.channel == f"{name}/acceleration"]
    ordered = without_held(with_tails(ordered, tails.tails), held)
    if not ordered.start.size:
        raise Undetermined(
            f"{name} repeats one reading in every {window:g} s", where=first.path,
            remedy="record it without a step that fills or holds samples",
        )  # fmt: skip
    warm = "temperature" in builders and builders["temperature"].windows()
    heat = believed(in_order(warm)[0] if warm else None)
    return Scan(
        windows=ordered, temperature=heat.windows, triad=name, rate=rate,
        samples=samples, stop=stop, gaps=gaps, path=first.path, format=first.format,
        sha256=first.sha256, start_ns=first.start_ns, mapping=first.mapping,
        notes=tuple(dict.fromkeys([*notes, *heat.words])), no_temperature=heat.gone,
    )  # fmt: skip


def _accelerometer(block: Recording, triad: str | None) -> str:
    """The triad to calibrate, or "" when this block has none."""
    found = [c for c in block.channels.values() if c.quantity == "acceleration"]
    names = [c.triad for c in found]
    if not names:
        return ""
    if (triad is None and len(names) > 1) or (triad is not None and triad not in names):
        raise UsageError(
            f"{len(names)} accelerometers to choose from",
            where=block.path,
            remedy=f"name one with --triad: {', '.join(names)}",
        )
    chosen = found[names.index(triad)] if triad else found[0]
    if chosen.unit != "m/s2":
        raise UnreadableInput(
            f"the acceleration has no scale (unit {chosen.unit})",
            where=block.path,
            remedy="give --unit, or --unit counts with --lsb; epoch counts cannot be used",
        )
    return chosen.triad


def _chosen(block: Recording, triad: str) -> list[tuple[str, Channel]]:
    return [
        (c.quantity, c)
        for c in block.channels.values()
        if (c.quantity == "acceleration" and c.triad == triad)
        or (c.quantity == "temperature" and c.triad in (triad, "") and c.unit == "degC")
    ]


def posture_runs(scanned: Scan, settings: StillSettings = WORN) -> PostureRuns:
    """Runs of still windows of one posture. Raises Undetermined when nothing is still, and
    UnreadableInput when the size of the readings at rest cannot be gravity, or is another one from
    some moment on."""
    w = scanned.windows
    refuse_two_ranges(w.start, w.mean, scanned.path)
    sensor = Sensor(scanned.triad, "acceleration", scanned.rate, w, settings.quietest)
    dead = stuck(sensor)
    live = np.flatnonzero(~dead.windows)
    if not live.size:
        raise Undetermined("; ".join(dead.words), where=scanned.path)
    sensor = without(sensor, dead)
    still, notes = still_windows(sensor, settings)
    chosen = live[still]
    chosen = np.setdiff1d(chosen, overlapping(w, chosen))
    if not chosen.size:
        raise Undetermined(
            "; ".join(["no window of the recording is still", *notes, *dead.words]),
            where=scanned.path,
            remedy="wear it through a night; `imucal inspect` shows the noise",
        )
    runs = grouped(scanned, chosen, sensor.noise, tuple(notes))
    runs = _with_temperature(runs)
    return replace(runs, faults=(*dead.words, *limits(sensor, settings)))


def _with_temperature(runs: PostureRuns) -> PostureRuns:
    """The runs that have a temperature, where the thermometer measured any."""
    known = np.isfinite(runs.temperature)
    if known.all() or not known.any():
        return runs
    names = ("mean", "windows", "time", "temperature")
    note = f"{int((~known).sum())} of {known.size} posture runs left out: they have no temperature"
    kept = {name: getattr(runs, name)[known] for name in names}
    return replace(runs, **kept, notes=(*runs.notes, note))


def grouped(scanned: Scan, chosen: Index, noise: Array, notes: tuple[str, ...] = ()) -> PostureRuns:
    """Runs from the indices of still windows."""
    w = scanned.windows
    size = np.linalg.norm(w.mean[chosen], axis=1)
    if not 0.5 < float(np.median(size)) / STANDARD_GRAVITY < 1.5:
        raise UnreadableInput(
            f"the norm at rest is {float(np.median(size)) / STANDARD_GRAVITY:.3g} g: wrong unit",
            where=scanned.path,
            remedy="give --unit; counts of activity per epoch cannot be calibrated",
        )
    starts = postures_begin(w, chosen)
    count = np.diff(np.append(starts, chosen.size)).astype(np.intp)
    middle = 0.5 * (w.start + w.stop)[chosen]

    def mean(values: Array) -> Array:
        total = np.add.reduceat(values, starts, axis=0)
        return np.asarray((total.T / count).T)

    begin, end = w.start[chosen], w.stop[chosen]
    warm = temperature_in(scanned.temperature, scanned.no_temperature, begin, end)
    inside = np.setdiff1d(np.arange(1, chosen.size), starts)
    steps = np.square(size[inside] - size[inside - 1])
    # Median of a squared normal number is 0.455 of its variance; a difference has twice it.
    scatter = float(np.sqrt(np.median(steps) / 2.0 / 0.4549)) if steps.size else 0.0
    white = float(np.median(noise)) / np.sqrt(w.samples)
    return PostureRuns(
        mean=mean(w.mean[chosen]),
        windows=count,
        time=mean(middle),
        temperature=mean_of_known(warm, starts),
        window_noise=max(scatter, white),
        still=chosen.size,
        total=w.start.size,
        noise=noise,
        notes=notes,
        resolution=np.where(np.isfinite(w.finest), w.finest, 0.0),
    )
