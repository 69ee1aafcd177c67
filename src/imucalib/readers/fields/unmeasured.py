"""Samples that are no measurement, whatever the format: without a value, beyond what a sensor can
read, and repeats of the one before to the last digit (held, copied or filled in).

Noise of σ steps leaves an axis on its number with a chance p(σ), all three with the product, and a
run of n repeats with its n-th power. What the recording's own noise at its quietest cannot do,
somebody has written. A converter that is coarser than its noise repeats honestly, for minutes: of
such a one nothing is said here. Nor of a gyroscope whose dead zone reads one number at rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import erf, log, sqrt

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.readers.fields.joining import add_notes, amend_last
from imucalib.readers.fields.timebase import find_gaps, measure_steps
from imucalib.readers.fields.words import INERTIAL
from imucalib.recording.recording import Channel, Count, Gap, HeldSamples, Recording
from imucalib.units import STANDARD_GRAVITY

#: m/s². Accelerometers that rest in gravity for a calibration end far below it.
_MOST = 1000.0 * STANDARD_GRAVITY
_FEW = 0.5  # share of a block: more is no sample that went wrong, but a wrong unit
#: s, and samples at least and at most, that a difference's size and step are taken from: half of a
#: rest of a second, so that one lies within it.
_SECONDS, _PIECE = 0.5, (32, 128)
_PIECES = 256  # of a channel that are kept, at most
_LIVE = 4  # steps of such a piece that must change something
_QUIETEST = 0.05  # share of the quiet pieces that has the noise of rest
#: What is quiet spreads by no more than the noisiest common accelerometer, as a share of gravity
#: (`rests.stillness`), and a gyroscope by what a rest in the hand has, rad/s: without such pieces
#: nothing is known of the noise at rest, as where a coarse converter stands still in all of it.
_LOUDEST, _TURNING, _FEWEST = 0.03, 0.05, 3
_SHOWN = 1.0  # noise in steps from which a standstill of all axes is no matter of resolution
_NATS = 20.0  # chance e^-20 of a false word in a whole recording
_LOOKED = 2000  # runs of a block whose neighbours are looked at
_TIMES = 4  # a run this many times longer than the usual one is none of the copies
_VALUES = 1000  # numbers of a gyroscope that are counted
_ZONE, _ZONE_SHARE = 3, 0.2  # runs of one number, and of all of them, that make a dead zone


def drop_impossible(blocks: Iterable[Recording]) -> Iterator[Recording]:
    """The same blocks without samples of accelerometers and gyroscopes that lack a value or that no
    sensor reads; the last one's notes and counts say how many there were."""
    found: dict[str, _Impossible] = {}

    def leave_out(block: Recording) -> Recording:
        channels, gaps = dict(block.channels), list(block.gaps)
        for name, channel in block.channels.items():
            if channel.quantity in INERTIAL and channel.t.size:
                one = found.setdefault(name, _Impossible())
                channels[name], new = one.without(channel)
                gaps += new
        return replace(block, channels=channels, gaps=tuple(gaps))

    def tell(last: Recording) -> Recording:
        notes = (note for name, one in found.items() for note in one.words(name))
        counts = tuple(_count(c, found, last) for c in last.counts)
        return add_notes(replace(last, counts=counts), notes)

    return amend_last(map(leave_out, blocks), tell)


@dataclass
class _Impossible:
    """Samples that were left out of a channel: without a value, and beyond what can be."""

    missing: int = 0
    beyond: int = 0

    def without(self, channel: Channel) -> tuple[Channel, list[Gap]]:
        """The channel without them, and the gaps that they leave."""
        values, most = channel.values, _MOST if channel.unit == "m/s2" else np.inf
        low, high = values.min(), values.max()
        if low >= -most and high <= most:
            return channel, []
        none: Flags = np.logical_not(np.isfinite(values).all(axis=1))
        beyond: Flags = np.logical_and(~none, (np.abs(values) > most).any(axis=1))
        if np.count_nonzero(beyond) > _FEW * beyond.size:
            beyond = np.zeros_like(beyond)
        left = none | beyond
        self.missing += int(np.count_nonzero(none))
        self.beyond += int(np.count_nonzero(beyond))
        t, rows = channel.t[~left], np.flatnonzero(~left).astype(np.float64)
        steps = measure_steps([t])
        gaps = find_gaps(t, rows, steps.threshold, None) if steps else []
        lacking = [gap for gap in gaps if gap.reason == "values missing"]
        return replace(channel, t=t, values=channel.values[~left]), lacking

    def words(self, name: str) -> Iterator[str]:
        """What there is to say of them."""
        if self.missing:
            yield f"{name}: {self.missing} samples without a value left out"
        if self.beyond:
            yield f"{name}: {self.beyond} samples beyond 1000 g, which none reads, left out"


def _count(count: Count, found: dict[str, _Impossible], last: Recording) -> Count:
    """A count with what was left out of its channels."""
    own = [
        one
        for name, one in found.items()
        if name in count.source
        or any(n in count.source for n in getattr(last.channels.get(name), "names", ()))
    ]
    lost = max((one.missing + one.beyond for one in own), default=0)
    if not lost:
        return count
    left = {**count.left, "that no sensor reads": lost}
    return replace(count, read=count.read - lost, left=left)


def mark_held(blocks: Iterable[Recording]) -> Iterator[Recording]:
    """The same blocks with `Recording.held` filled; the last one's notes say how many samples these
    are where there are any. Of a corrected sensor nothing is told: its axes are mixed, and no step
    of a converter is left to judge by."""
    seen: dict[str, _Repeats] = {}

    def look(block: Recording) -> Recording:
        held, corrected = list[HeldSamples](), {mark.triad for mark in block.corrections}
        # Accelerometers first: what both repeat at once is no gyroscope's dead zone.
        for name, channel in sorted(block.channels.items(), key=lambda c: c[1].quantity):
            measured = channel.quantity in INERTIAL and channel.t.size
            if measured and channel.triad not in corrected:
                force = [h for h in held if h.channel == f"{channel.triad}/acceleration"]
                held += seen.setdefault(name, _Repeats(name, channel)).add(channel, force)
        return replace(block, held=tuple(held)) if held else block

    def notes() -> Iterator[str]:
        return (word for found in seen.values() for word in found.words())

    return amend_last(map(look, blocks), lambda last: add_notes(last, notes()))


@dataclass
class _Repeats:
    """What one channel has shown so far.

    count : samples; repeats : of them, all that equal the one before, `held` of these in stretches
        that are no measurement, `zone` in a gyroscope's dead zone
    pieces : (k, axes) noise of a sample and smallest step, (k,) spread of the readings and size of
        their mean, of k pieces at a time
    step : (axes,) of the converter, at the quietest
    chance : of a repeat of all axes there, as a logarithm, 0 where nothing is known
    lengths : of runs of repeats; longest : s, of a stretch
    """

    name: str
    like: Channel
    count: int = 0
    repeats: int = 0
    pieces: list[tuple[Array, Array, Array, Array]] = field(default_factory=list)
    step: Array | None = None
    chance: float = 0.0
    lengths: list[Index] = field(default_factory=list)
    held: int = 0
    zone: int = 0
    stretches: int = 0
    longest: float = 0.0
    _last: tuple[float, Array] | None = None
    _running: tuple[float, int] | None = None  # begin and repeats of a run that may go on
    _runs_of: dict[bytes, int] = field(default_factory=dict)
    _runs: int = 0

    def add(self, channel: Channel, force: Sequence[HeldSamples]) -> list[HeldSamples]:
        """Take the next samples; the stretches among them that are no measurement.

        force : those of the accelerometer that a gyroscope belongs to
        """
        values, t = channel.values, channel.t
        self._look(channel)
        same = np.empty(t.size, dtype=np.bool_)
        same[0] = self._last is not None and bool((values[0] == self._last[1]).all())
        np.equal(values[1:, 0], values[:-1, 0], out=same[1:])
        for axis in range(1, values.shape[1]):  # rows of three are slow to reduce
            same[1:] &= values[1:, axis] == values[:-1, axis]
        self.count += t.size
        self.repeats += int(np.count_nonzero(same))
        found = self._find(same, channel, force) if self.chance and same.any() else []
        if not same[-1]:
            self._running = None
        self._last = float(t[-1]), values[-1].copy()
        return found

    def _look(self, channel: Channel) -> None:
        """Size of the noise and smallest step, from pieces all over the samples."""
        known = sum(len(size) for *_, size in self.pieces)
        length = int(np.clip(_SECONDS * channel.rate, *_PIECE))
        count = channel.t.size // length
        if not count or known >= _PIECES:
            return
        chosen = np.unique(np.linspace(0, count - 1, min(count, _PIECES - known)).astype(int))
        some = channel.values[chosen[:, None] * length + np.arange(length)]
        # Turned, so that every reduction runs along neighbouring numbers.
        values = np.ascontiguousarray(some.transpose(0, 2, 1))
        steps = np.abs(np.diff(values, axis=2))
        live = np.count_nonzero(np.logical_or.reduce(steps > 0.0, axis=1), axis=1)
        alive = np.isfinite(steps.sum(axis=(1, 2))) & (live > 0)
        values, steps, live = values[alive], np.minimum(steps[alive], 1e150), live[alive]
        if not len(steps):
            return
        # Few steps are those of a converter that hardly shows the noise.
        over = np.where(live >= _LIVE, live, steps.shape[2])
        noise = np.sqrt(0.5 * np.vecdot(steps, steps) / over[:, None])
        smallest = np.where(steps > 0.0, steps, np.inf).min(axis=2)
        size = np.linalg.norm(values.mean(axis=2), axis=1)
        self.pieces.append((noise, smallest, values.std(axis=2).max(axis=1), size))
        self.chance = self._chance()

    def _chance(self) -> float:
        noise, steps, spread, size = map(np.concatenate, zip(*self.pieces, strict=True))
        least = _TURNING if self.like.unit == "rad/s" else np.inf
        if self.like.quantity == "acceleration":
            least = _LOUDEST * float(np.median(size))
        quiet = spread <= least
        if quiet.sum() < _FEWEST:
            return 0.0
        noise, steps = noise[quiet], steps[quiet]
        moving = np.isfinite(steps).any(axis=0)
        level = np.quantile(noise[:, moving], _QUIETEST, axis=0)
        self.step = np.median(steps, axis=0)
        step = self.step[moving]
        if not moving.any() or not (level > _SHOWN * step).all():
            return 0.0
        return sum(log(_stays(float(n / s))) for n, s in zip(level, step, strict=True))

    def _find(
        self, same: Flags, channel: Channel, force: Sequence[HeldSamples]
    ) -> list[HeldSamples]:
        t, values = channel.t, channel.values
        starts = np.flatnonzero(same & ~np.append(False, same[:-1]))
        stops = np.flatnonzero(same & ~np.append(same[1:], False)) + 1
        lengths = stops - starts
        begins = t[np.maximum(starts - 1, 0)]
        grown = lengths.copy()
        if same[0] and self._last is not None:
            begin, earlier = self._running or (self._last[0], 0)
            begins[0], grown[0] = begin, lengths[0] + earlier
        self._running = (float(begins[-1]), int(grown[-1])) if stops[-1] == t.size else None
        if sum(n.size for n in self.lengths) < _PIECES:
            self.lengths.append(grown[:_PIECES].astype(np.intp))
        longest = (_NATS + log(self.count)) / -self.chance
        over = np.flatnonzero(grown > longest)
        both = [any(h.start < t[k] <= h.stop for h in force) for k in starts[over]]
        zone = self._in_dead_zone(values[starts[over]]) & ~np.array(both, dtype=np.bool_)
        self.zone += int(lengths[over[zone]].sum())
        if self.repeats - self.zone > 0.45 * self.count:  # a stream that repeats as a rule
            longest = max(longest, _TIMES * float(np.median(np.concatenate(self.lengths))))
        over = over[~zone & (grown[over] > longest)]
        noisy = [self._in_noise(channel, int(starts[k]), int(stops[k])) for k in over[:_LOOKED]]
        over = over[np.array(noisy + [True] * (len(over) - len(noisy)), dtype=np.bool_)]
        counted = len(over) > 0 and over[0] == 0 and bool(grown[0] - lengths[0] > longest)
        self.stretches += len(over) - counted
        self.held += int(lengths[over].sum())
        ends = t[stops[over] - 1]
        self.longest = max([self.longest, *(ends - begins[over]).tolist()])
        pairs = zip(begins[over].tolist(), ends.tolist(), strict=True)
        return [HeldSamples(self.name, begin, end) for begin, end in pairs]

    def _in_noise(self, channel: Channel, first: int, stop: int) -> bool:
        """Whether a run of repeats lies among samples that show their noise: between others that
        hardly change, a converter is coarser than what is there to convert."""
        around = _PIECE[1] // 2
        pieces = channel.values[max(first - around, 0) : first], channel.values[stop:][:around]
        steps = [np.abs(np.diff(p, axis=0)) for p in pieces if len(p) > 1]
        every = np.concatenate([np.empty((0, channel.values.shape[1])), *steps])
        changed = every.any(axis=1)
        if changed.sum() < 2 * _LIVE:
            return False
        if self.step is None:
            return True
        noise = np.sqrt(0.5 * (np.minimum(every[changed], 1e150) ** 2).mean(axis=0))
        moving = np.isfinite(self.step)
        return bool((noise[moving] > _SHOWN * self.step[moving]).all())

    def _in_dead_zone(self, rows: Array) -> Flags:
        """Which of a gyroscope's runs read a number that many of its runs read, or zero."""
        if self.like.quantity != "angular_rate":
            return np.zeros(len(rows), dtype=np.bool_)
        keys = [row.tobytes() for row in rows + 0.0]  # a zero may have a sign
        for key in keys:
            if key in self._runs_of or len(self._runs_of) < _VALUES:
                self._runs_of[key] = self._runs_of.get(key, 0) + 1
        self._runs += len(keys)
        least = max(_ZONE, _ZONE_SHARE * self._runs)
        zone = np.array([self._runs_of.get(key, 0) >= least for key in keys], dtype=np.bool_)
        return zone | ~rows.any(axis=1)

    def words(self) -> Iterator[str]:
        """What there is to say of the channel."""
        if self.held:
            yield (
                f"{self.name}: {self.held} samples repeat the one before to the last digit, in "
                f"{self.stretches} stretches of up to {self.longest:.3g} s, as its noise never "
                "does: held or filled in; no rest and no noise is taken from them"
            )
        rest, by_chance = self.repeats - self.held - self.zone, self.count * np.exp(self.chance)
        share = rest / max(self.count, 1)
        if self.chance and share > 0.1 and rest * (log(rest / by_chance) - 1.0) > 3.0 * _NATS:
            yield (
                f"{self.name}: {100.0 * share:.2g} % of the samples repeat the one before to the "
                f"last digit: the sensor gives about {self.like.rate * (1.0 - share):.4g} new ones "
                "a second, and the others are copies"
            )


def _stays(noise: float) -> float:
    """Chance that two samples of a noise, in steps, read one number: at most, at its centre."""
    if noise > 20.0:
        return 1.0 / (2.0 * sqrt(np.pi) * min(noise, 1e300))  # a damaged number may be of any size
    edges = [erf((k + 0.5) / (noise * sqrt(2.0))) for k in range(int(8 * noise) + 2)]
    total = edges[0] ** 2
    for inner, outer in pairwise(edges):
        total += 2.0 * (0.5 * (outer - inner)) ** 2
    return total
