"""Posture runs: still windows of a worn sensor, grouped while the posture lasts.

Windows of one posture share what the posture does to the sensor, so a run of them is one
observation: its mean reading, time and temperature, and how many windows it averages. Looked at
before: a change of range or unit within the recording; the rest before a gap (a worn sensor falls
asleep because it has been at rest); and axes that repeat one number.

Two things tell such an axis from a live one. Noise of σ steps leaves a sample within one step with
the chance erf(1 / (2√2 σ)), which a stretch of n samples has to the n-th power. And gravity that
moves on the other axes, with the jolts that this takes, moves every axis by more than one step. An
axis that is held but keeps its noise repeats nothing: it stays at one mean, while the size of
gravity, which no posture changes, does not stay.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.recording.identity import NAMELESS, Identity, identity_of
from imucalib.recording.recording import Channel, Gap, HeldSamples, Recording
from imucalib.recording.sensors import accelerometers, undecided
from imucalib.rests.stillness import Sensor, StillSettings, all_axes, any_axis, still_windows
from imucalib.rests.thermal import ThermalHistory, believable_windows, mean_of_known
from imucalib.rests.windows import (
    WindowBuilder,
    Windows,
    find_breaks,
    join_windows,
    usable_windows,
    window_statistics,
)
from imucalib.units import MG, STANDARD_GRAVITY

_CHANGE = 20.0 * MG  # between neighbouring windows of one posture, at most
_REACH = 30.0 * MG  # between any window of a run and its first
_RATIO = 1.3  # between two sizes of gravity that no sensor's errors explain
_CLEARER = 5.0  # times that two levels leave less scatter than one: a steady drift leaves a quarter
_FEWEST = 5  # windows on either side of a change of range
#: Chance up to which noise has not done it: e^-60, for samples of a filter are not independent.
_NATS = 60.0
#: Noise in steps from which the resolution shows it.
_SHOWN = 0.5
#: Seconds at least, and share of gravity by which another axis moves meanwhile.
_SECONDS, _MOVED = 60.0, 0.2
_FAR, _ENDS = _MOVED * STANDARD_GRAVITY, 2
#: Noise of an axis that is still, and steps of its mean from window to window, in its own noise.
_CALM, _ON = 3.0, 2.0
#: Share of gravity from which on a limit is beyond every rest, whatever the bias.
_BEYOND = 1.1
#: Of a worn sensor: ten-second windows, as the field uses, three axes, noise plus a sway of 3 mg
#: that breathing causes. Together they tilt the mean by less than 1e-5 of its size.
WORN = StillSettings(
    window=10.0,
    shortest=5.0,
    variance_ratio=2.25,
    range_ratio=12.0,
    sway=3.3 * MG,
    quietest=0.05,
)


def _postures_begin(w: Windows, chosen: Index) -> Index:
    """Positions in `chosen` where a run begins: a gap, a jump, or too far from its start."""
    reading = w.mean[chosen]
    apart = ~w.joined(chosen) | (np.linalg.norm(np.diff(reading, axis=0), axis=1) > _CHANGE)
    starts = np.concatenate([[0], np.flatnonzero(apart) + 1])
    while True:
        owner = np.repeat(starts, np.diff(np.append(starts, chosen.size)))
        far = np.linalg.norm(reading - reading[owner], axis=1) > _REACH
        if not far.any():
            return starts.astype(np.intp)
        # The first far window of each run begins a new one.
        first = np.unique(owner[far], return_index=True)[1]
        starts = np.union1d(starts, np.flatnonzero(far)[first])


def two_ranges(size: Array) -> tuple[int, float, float] | None:
    """The two ranges of sizes (n,) in order of time: row of the first size after the change, and
    the medians before and after it; None where one range does.

    One split by least squares of the logarithm: a range is a factor.
    """
    n = size.size
    if n < 2 * _FEWEST or not np.all(size > 0.0):
        return None
    x = np.log(size)
    x = x - x.mean()
    rows = np.arange(_FEWEST, n - _FEWEST + 1)
    total = np.cumsum(x)[rows - 1]
    explained = total**2 / rows + total**2 / (n - rows)
    best = int(np.argmax(explained))
    row, unexplained = int(rows[best]), float(np.sum(x**2) - explained[best])
    before, after = float(np.median(size[:row])), float(np.median(size[row:]))
    far = max(before, after) > _RATIO * min(before, after)
    return (row, before, after) if far and _CLEARER * unexplained < float(np.sum(x**2)) else None


def _refuse_two_ranges(w: Windows, path: str) -> None:
    """Raises UnreadableInput where windows read gravity in two ranges. All take part: with the
    range the noise changes, and one part is not still."""
    change = two_ranges(np.linalg.norm(w.mean, axis=1))
    if change is None:
        return
    row, before, after = change
    raise UnreadableInput(
        f"gravity is {before / STANDARD_GRAVITY:.3g} g before {w.start[row] / 3600.0:.2f} h and "
        f"{after / STANDARD_GRAVITY:.3g} g from there on: the range or the unit changes",
        where=path,
        remedy="export it in two files at that moment, each with its own scale, or one for all",
    )


@dataclass(frozen=True)
class Tail:
    """The last samples of a run: times (w,) s and values (w, k); begin : s, of the run."""

    begin: float
    t: Array
    values: Array


class _TailBuilder:
    """Collects the last `samples` samples before every gap, from consecutive blocks."""

    def __init__(self, samples: int) -> None:
        self.samples = samples
        self.tails: list[Tail] = []
        self._t: Array = np.empty(0)
        self._values: Array | None = None
        self._begin = 0.0

    def add(self, channel: Channel, gaps: Sequence[Gap]) -> None:
        """Take the next block of the channel, with the gaps that the block reports."""
        if not channel.t.size:
            return
        w, t, values = self.samples, channel.t, channel.values
        if self._values is None:
            self._begin = float(t[0])
        elif gaps or t.size < w:
            t, values = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        edges = find_breaks(t, gaps).tolist() if gaps else []
        for a, b in pairwise([0, *edges]):
            if b - a >= w:
                self.tails.append(Tail(self._begin, t[b - w : b].copy(), values[b - w : b].copy()))
            self._begin = float(t[b])
        first = max(edges[-1] if edges else 0, t.size - w)
        self._t, self._values = t[first:].copy(), values[first:].copy()


def _add_tails(windows: Windows, tails: Sequence[Tail]) -> Windows:
    """The windows and, in order of time, those before gaps; these may overlap the one before."""
    if not tails:
        return windows
    mean, variance, low, high, _ = window_statistics(np.stack([tail.values for tail in tails]))
    start = np.array([tail.t[0] for tail in tails])
    before = np.searchsorted(windows.start, start, side="right") - 1
    same = (before >= 0) & (windows.start[before] >= [tail.begin for tail in tails])
    own = replace(
        windows,
        first=np.full(len(tails), -1, np.intp),
        run=np.where(same, windows.run[before], -1 - np.arange(len(tails))),
        start=start,
        stop=np.array([tail.t[-1] for tail in tails]),
        mean=mean,
        variance=variance,
        low=low,
        high=high,
    )
    whole = join_windows([windows, own])
    return whole.take(np.argsort(whole.start, kind="stable"))


def _stuck(sensor: Sensor) -> tuple[Flags, list[str]]:
    """Windows (m,) in which an axis repeats one number while it should not, or did within a window;
    words of each such axis. At the end of the recording's own range that is clipping, `_limits`.
    """
    w = sensor.windows
    found = np.zeros(w.start.size, dtype=np.bool_)
    constant = w.high == w.low
    frozen = all_axes(constant)
    words = []
    for axis in np.flatnonzero((constant & ~frozen[:, None]).any(axis=0)):
        dead = _dead(sensor, int(axis), constant[:, axis], frozen)
        if dead.any():
            values = np.unique(w.high[dead, axis])
            # A converter's zero may have a sign, which is no news.
            value = f"{values[0] / STANDARD_GRAVITY + 0.0:.3g} g"
            words.append(
                f"{'xyz'[axis]} repeats {value if values.size == 1 else 'one number'} "
                f"{_when(sensor, dead)}, while it should move: stuck, or at a limit; left out of "
                "the rests"
            )
            found |= dead
    while True:  # what one held axis makes of gravity's size is no sign of the others
        each = [_held(sensor, axis, found) for axis in range(w.mean.shape[1])]
        most = int(np.argmax([held.sum() for held in each]))
        held = each[most]
        if not held.any():
            break
        words.append(
            f"{'xyz'[most]} stays at {np.median(w.mean[held, most]) / STANDARD_GRAVITY:.3g} g "
            f"{_when(sensor, held)}, whatever the others do: it is not its own reading; left out "
            "of the rests"
        )
        found |= held
    neighbours = np.append(False, found[:-1]) | np.append(found[1:], False)
    return found | neighbours, words


def _dead(sensor: Sensor, axis: int, constant: Flags, frozen: Flags) -> Flags:
    """frozen : (m,) windows in which all axes stand still, as asleep"""
    w, value = sensor.windows, sensor.windows.high[:, axis]
    joined = constant[1:] & constant[:-1] & (value[1:] == value[:-1])
    starts = np.flatnonzero(np.append(True, ~joined)).astype(np.intp)
    count = np.diff(starts, append=constant.size)
    dead = _move(w, axis, starts) & (count * w.samples >= _SECONDS * sensor.rate)
    step, noise = float(sensor.step[axis]), float(sensor.noise[axis])
    if step > 0.0 and noise >= _SHOWN * step:
        stays = math.log(math.erf(0.5 * step / (math.sqrt(2.0) * noise)))
        alone = np.add.reduceat((~frozen).astype(np.float64), starts) * w.samples
        ends = (value == value.max()) | (value == w.low[:, axis].min())
        dead |= (-alone * stays > _NATS) & ~ends[starts]
    return np.asarray(constant & np.repeat(dead, count))


def _held(sensor: Sensor, axis: int, known: Flags) -> Flags:
    """Stretches in which an axis keeps its mean and its noise, through all that moves the others:
    what is still there has a size that gravity has not."""
    w, noise = sensor.windows, np.maximum(sensor.noise, sensor.step)
    if _CALM * noise.max() > _FAR:  # what is shaken all the time changes its size by itself
        return np.zeros(w.start.size, dtype=np.bool_)
    calm = (w.variance <= (_CALM * noise) ** 2) & ~known[:, None]
    value, size = w.mean[:, axis], np.linalg.norm(w.mean, axis=1)
    joined = calm[1:, axis] & calm[:-1, axis]
    joined &= np.abs(np.diff(value)) <= _ON * noise[axis]
    starts = np.flatnonzero(np.append(True, ~joined)).astype(np.intp)
    count = np.diff(starts, append=value.size)
    still = all_axes(calm)
    largest = np.maximum.reduceat(np.where(still, size, -np.inf), starts)
    smallest = np.minimum.reduceat(np.where(still, size, np.inf), starts)
    long = count * w.samples >= _SECONDS * sensor.rate
    held = np.repeat(long & (largest - smallest > _FAR), count)
    return np.asarray(held & ~known)


def _move(w: Windows, axis: int, starts: Index) -> Flags:
    """Whether another axis moves far within each stretch, by more than the motion that may reach
    into its first and last window with a sample or two."""
    others = [k for k in range(w.high.shape[1]) if k != axis]
    mean, far = w.mean[:, others], any_axis(w.high[:, others] - w.low[:, others] > _FAR)
    reach = np.maximum.reduceat(mean, starts) - np.minimum.reduceat(mean, starts)
    return np.asarray(
        any_axis(reach > _FAR) | (np.add.reduceat(far.astype(np.intp), starts) > _ENDS)
    )


def _when(sensor: Sensor, flags: Flags) -> str:
    w = sensor.windows
    seconds = float(flags.sum()) * w.samples / sensor.rate
    long = f"{seconds / 3600.0:.2g} h" if seconds >= 3600.0 else f"{seconds / 60.0:.2g} min"
    return f"for {long} from {float(w.start[int(np.argmax(flags))]) / 3600.0:.2f} h on"


def _limits(sensor: Sensor) -> list[str]:
    """Axes that stand at the end of their range at rest, in words."""
    w, found = sensor.windows, list[str]()
    if not sensor.fine:
        return found
    constant = w.high == w.low
    quiet = all_axes(w.variance <= sensor.settings.variance_ratio * sensor.allowed**2)
    single = constant & ~all_axes(constant)[:, None] & quiet[:, None]
    for axis, name in enumerate("xyz"[: constant.shape[1]]):
        for value, word in ((w.high[:, axis].max(), "above"), (w.low[:, axis].min(), "below")):
            size = float(value) / STANDARD_GRAVITY
            at = int((single[:, axis] & (w.high[:, axis] == value)).sum())
            if at and abs(size) < _BEYOND:
                found.append(
                    f"{name} reads nothing {word} {size:.3g} g: {at} windows at rest stand at "
                    "that limit and are left out; what lies beyond it no calibration brings back"
                )
    return found


@dataclass(frozen=True)
class Scan:
    """What one pass over a recording leaves: windows of the accelerometer and the temperature.

    samples : of the accelerometer; rate : Hz; stop : s, time of the last sample; sensor : whose
    """

    windows: Windows
    temperature: ThermalHistory | None
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
    sensor: Identity = NAMELESS

    def drop_windows(self) -> Scan:
        """The rest, once the runs are made: the windows are most of the memory."""
        return replace(self, windows=self.windows.take(np.zeros(0, np.intp)))


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

    def take(self, rows: Index | Flags) -> PostureRuns:
        """Some of the runs; what is of the whole recording stays."""
        own = ("mean", "windows", "time", "temperature")
        return replace(self, **{name: getattr(self, name)[rows] for name in own})


def scan(blocks: Iterable[Recording], window: float) -> Scan:
    """One pass over a recording in blocks; memory is that of a block and of the windows.

    Raises UsageError when it is not clear which accelerometer, UnreadableInput when it has no
    scale, Undetermined when it is shorter than one window.
    """
    builders: dict[str, WindowBuilder] = {}
    tails: _TailBuilder | None = None
    known: dict[str, Channel] = {}
    sensor = NAMELESS
    name, rate, samples, stop, gaps = "", 0.0, 0, 0.0, 0
    notes: list[str] = []
    held: list[HeldSamples] = []
    first: Recording | None = None
    for block in blocks:
        first = first or block
        notes += block.notes
        held += block.held
        gaps += len(block.gaps)
        known |= accelerometers(block)
        if known and not name:
            name = _accelerometer(known, block.path)
            sensor = identity_of(block, name)
        for key, channel in _choose(block, name):
            per = max(1 if key == "temperature" else 5, round(window * channel.rate))
            builders.setdefault(key, WindowBuilder(per)).add(channel, block.gaps)
            if key == "acceleration":
                tails = tails or _TailBuilder(max(5, round(WORN.shortest * channel.rate)))
                tails.add(channel, block.gaps)
                rate, samples = rate or channel.rate, samples + channel.t.size
                stop = max(stop, float(channel.t[-1])) if channel.t.size else stop
    if first is None or tails is None:
        raise undecided((), "", first.path if first else "")
    ordered, lost = usable_windows(
        builders["acceleration"],
        held,
        f"{name}/acceleration",
        first.path,
        with_more=lambda windows: _add_tails(windows, tails.tails),
    )
    notes += [f"{lost} windows left out: time had stepped back"] * bool(lost)
    warm = builders["temperature"].windows() if "temperature" in builders else None
    temperature, words = believable_windows(warm)
    return Scan(
        windows=ordered,
        temperature=temperature,
        triad=name,
        rate=rate,
        samples=samples,
        stop=stop,
        gaps=gaps,
        path=first.path,
        format=first.format,
        sha256=first.sha256,
        start_ns=first.start_ns,
        mapping=first.mapping,
        sensor=sensor,
        notes=tuple(dict.fromkeys([*notes, *words])),
    )


def _accelerometer(found: dict[str, Channel], path: str) -> str:
    """The sensor to calibrate."""
    if len(found) > 1:
        raise undecided(found, "", path)
    (chosen,) = found.values()
    if chosen.unit != "m/s2":
        raise UnreadableInput(
            f"the acceleration has no scale (unit {chosen.unit})",
            where=path,
            remedy="give --unit, or --unit counts with --lsb; epoch counts cannot be used",
        )
    return chosen.triad


def _choose(block: Recording, triad: str) -> list[tuple[str, Channel]]:
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
    _refuse_two_ranges(w, scanned.path)
    sensor = Sensor(scanned.triad, "acceleration", scanned.rate, w, settings)
    dead, words = _stuck(sensor)
    live = np.flatnonzero(~dead)
    if not live.size:
        remedy = "record again with another sensor, or once the axis is mended"
        raise Undetermined("; ".join(words), where=scanned.path, remedy=remedy)
    sensor = replace(sensor, windows=w.take(live)) if dead.any() else sensor
    still, notes = still_windows(sensor)
    chosen = live[still]
    # Not what shares samples with the still window before.
    apart = np.append(True, w.start[chosen[1:]] > w.stop[chosen[:-1]])
    chosen = chosen[apart[: chosen.size]]
    if not chosen.size:
        raise Undetermined(
            "; ".join(["no window of the recording is still", *notes, *words]),
            where=scanned.path,
            remedy="wear it through a night; `imucal inspect` shows the noise",
        )
    runs = _add_temperature(group_windows(scanned, chosen, sensor.noise, tuple(notes)))
    return replace(runs, faults=(*words, *_limits(sensor)))


def _add_temperature(runs: PostureRuns) -> PostureRuns:
    """The runs that have a temperature, where the thermometer measured any."""
    known = np.isfinite(runs.temperature)
    if known.all() or not known.any():
        return runs
    note = f"{int((~known).sum())} of {known.size} posture runs left out: they have no temperature"
    return replace(runs.take(known), notes=(*runs.notes, note))


def group_windows(
    scanned: Scan, chosen: Index, noise: Array, notes: tuple[str, ...] = ()
) -> PostureRuns:
    """Runs from the indices of still windows."""
    w = scanned.windows
    size = np.linalg.norm(w.mean[chosen], axis=1)
    if not 0.5 < float(np.median(size)) / STANDARD_GRAVITY < 1.5:
        raise UnreadableInput(
            f"the norm at rest is {float(np.median(size)) / STANDARD_GRAVITY:.3g} g: wrong unit",
            where=scanned.path,
            remedy="give --unit; counts of activity per epoch cannot be calibrated",
        )
    starts = _postures_begin(w, chosen)
    count = np.diff(np.append(starts, chosen.size)).astype(np.intp)

    def mean(values: Array) -> Array:
        total = np.add.reduceat(values, starts, axis=0)
        return np.asarray((total.T / count).T)

    warm = np.full(chosen.size, np.nan)
    if scanned.temperature is not None:
        warm = scanned.temperature.temperature(w.middle[chosen])
    inside = np.setdiff1d(np.arange(1, chosen.size), starts)
    steps = np.square(size[inside] - size[inside - 1])
    # Median of a squared normal number is 0.455 of its variance; a difference has twice it.
    scatter = float(np.sqrt(np.median(steps) / 2.0 / 0.4549)) if steps.size else 0.0
    white = float(np.median(noise)) / np.sqrt(w.samples)
    return PostureRuns(
        mean=mean(w.mean[chosen]),
        windows=count,
        time=mean(w.middle[chosen]),
        temperature=mean_of_known(warm, starts),
        window_noise=max(scatter, white),
        still=chosen.size,
        total=w.start.size,
        noise=noise,
        notes=notes,
        resolution=np.where(np.isfinite(w.finest), w.finest, 0.0),
    )
