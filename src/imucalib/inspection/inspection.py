"""What a recording holds, before anything is calibrated: channels, clock, rest, units, losses."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from imucalib.arrays import Array
from imucalib.errors import ImucalError
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.rests.segments import Segments, StillSettings, find_segments
from imucalib.units import STANDARD_GRAVITY

_KEPT = 10  # candidates and gaps that are listed; the rest is counted
_LOSS = re.compile(
    r"\bdamaged\b|\blost\b|cannot be (read|decoded)|did not close|may be cut|never defines"
    r"|zero bytes|are missing|without its footer|^\d+ rows left out"
)
_REPEATS = re.compile(r"repeat the one before to the last digit")
_STEPS = 1 << 16  # steps a channel keeps for the jitter


@dataclass(frozen=True)
class ClockFacts:
    """The clock of one channel.

    rate : Hz, from the median step; span : s; jitter : s, 1.4826 times the median absolute
    deviation of the steps; duplicates, back_steps : counts; longest_step : s
    """

    rate: float
    span: float
    jitter: float
    duplicates: int
    back_steps: int
    longest_step: float


@dataclass(frozen=True)
class ChannelFacts:
    """One channel; low, high : (k,) extremes; noise : (k,) of one sample at rest, or empty.

    norm_at_rest : median norm over the still segments, in the channel's unit; NaN without rest
    names : what the file calls the sensor: topic, dataset; a board or a calibration may go by these
    """

    name: str
    quantity: str
    triad: str
    unit: str
    samples: int
    clock: ClockFacts
    low: Array
    high: Array
    noise: Array
    norm_at_rest: float
    names: tuple[str, ...] = ()


@dataclass(frozen=True)
class Inspection:
    """All that `imucal inspect` tells.

    gaps : the longest few; gap_count : of all; gap_seconds : in which any sensor has one
    still : the still segments, or None with `why_not_still` saying why there are none
    candidates : channels whose norm at rest is that of gravity, best first, with the reason
    mapping : the resolved mapping, to be saved and used for other files
    """

    path: str
    format: str
    sha256: str
    start_ns: int | None
    span: float
    channels: tuple[ChannelFacts, ...]
    gaps: tuple[Gap, ...]
    gap_count: int
    gap_seconds: float
    still: Segments | None
    why_not_still: str
    candidates: tuple[tuple[str, str], ...]
    mapping: Mapping[str, object]
    notes: tuple[str, ...]

    @property
    def losses(self) -> tuple[str, ...]:
        """The notes that tell of data that is in the file no more, or not readable."""
        return tuple(note for note in self.notes if _LOSS.search(note))

    @property
    def repeats(self) -> tuple[str, ...]:
        """The notes that tell of samples which are no measurement, one a channel at most."""
        return tuple(note for note in self.notes if _REPEATS.search(note))


class _Running:
    """What one channel has shown so far, block by block."""

    def __init__(self, channel: Channel) -> None:
        self.example = channel
        self.samples, self.duplicates, self.back_steps = 0, 0, 0
        self.first, self.last, self.longest = float(channel.t[0]), math.nan, 0.0
        self.low = np.full(channel.values.shape[1], np.inf)
        self.high = -self.low
        self.steps: list[Array] = []

    def add(self, channel: Channel) -> None:
        before = [] if math.isnan(self.last) else [self.last]
        steps = np.diff(np.concatenate([before, channel.t]))
        self.duplicates += int((steps == 0).sum())
        self.back_steps += int((steps < 0).sum())
        self.longest = max(self.longest, float(steps.max(initial=0.0)))
        if sum(s.size for s in self.steps) < _STEPS:
            self.steps.append(steps[:_STEPS])
        self.samples += channel.t.size
        self.last = float(channel.t[-1])
        self.low = np.minimum(self.low, channel.values.min(axis=0))
        self.high = np.maximum(self.high, channel.values.max(axis=0))

    def clock(self) -> ClockFacts:
        steps = np.concatenate(self.steps)
        steps = steps[steps > 0]
        middle = float(np.median(steps)) if steps.size else math.nan
        jitter = 1.4826 * float(np.median(np.abs(steps - middle))) if steps.size else math.nan
        span = self.last - self.first
        return ClockFacts(
            1.0 / middle, span, jitter, self.duplicates, self.back_steps, self.longest
        )


@dataclass
class _Watch:
    """What passes by while the still segments are sought."""

    seen: dict[str, _Running] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    last: Recording | None = None

    def watched(self, blocks: Iterable[Recording]) -> Iterator[Recording]:
        """The blocks, noticed."""
        for block in blocks:
            self.last = block
            self.gaps.extend(block.gaps)
            self.notes.extend(n for n in block.notes if n not in self.notes)
            for name, channel in block.channels.items():
                if channel.t.size:
                    self.seen.setdefault(name, _Running(channel)).add(channel)
            yield block

    @property
    def span(self) -> float:
        """Seconds from the first to the last sample of any channel."""
        firsts = [r.first for r in self.seen.values()]
        return max((r.last for r in self.seen.values()), default=0.0) - min(firsts, default=0.0)


def inspect_recording(
    blocks: Iterable[Recording], settings: StillSettings | None = None
) -> Inspection:
    """Inspect a recording given in blocks (a whole one as a list of one), in one pass.

    Raises what the blocks raise; a recording without rest or acceleration is told, not refused.
    """
    watch = _Watch()
    stream = watch.watched(blocks)
    still, why = None, ""
    try:
        still = find_segments(stream, settings)
    except ImucalError as error:
        if watch.last is None:  # nothing was read: the reader's own error
            raise
        why = error.what
    for _ in stream:  # what the detector left unread, if it gave up early
        pass
    whole = watch.last
    if whole is None:
        raise ValueError("inspect_recording needs at least one block")
    facts = tuple(_facts(name, running, still) for name, running in watch.seen.items())
    return Inspection(
        path=whole.path,
        format=whole.format,
        sha256=whole.sha256,
        start_ns=whole.start_ns,
        span=watch.span,
        channels=facts,
        gaps=tuple(sorted(watch.gaps, key=lambda g: g.start - g.stop)[:_KEPT]),
        gap_count=len(watch.gaps),
        gap_seconds=_covered(watch.gaps),
        still=still,
        why_not_still=why,
        candidates=_candidates(facts),
        mapping=whole.mapping,
        notes=(*watch.notes, *_unnamed(watch), *(still.notes if still else ())),
    )


def _unnamed(watch: _Watch) -> tuple[str, ...]:
    """That sensors have numbers only, where there are several."""
    found = {r.example.triad for r in watch.seen.values() if r.example.numbered}
    if len(found) < 2:
        return ()
    return (f"the file has no names for its {len(found)} sensors: they are numbered in its order",)


def _facts(name: str, running: _Running, still: Segments | None) -> ChannelFacts:
    channel = running.example
    noise, norm = np.empty(0), math.nan
    if still is not None and channel.triad in still.triads:
        at = still.triads.index(channel.triad)
        if channel.quantity == "acceleration":
            noise = still.noise[at]
            if still.n:
                norm = float(np.median(np.linalg.norm(still.mean[:, at], axis=1)))
        elif channel.quantity == "angular_rate" and np.isfinite(still.rate_noise[at]).all():
            noise = still.rate_noise[at]
            if still.n:
                norm = float(np.median(np.linalg.norm(still.rate[:, at], axis=1)))
    return ChannelFacts(
        name=name,
        quantity=channel.quantity,
        triad=channel.triad,
        unit=channel.unit,
        samples=running.samples,
        clock=running.clock(),
        low=running.low,
        high=running.high,
        noise=noise,
        norm_at_rest=norm,
        names=channel.names,
    )


def _candidates(facts: tuple[ChannelFacts, ...]) -> tuple[tuple[str, str], ...]:
    """Accelerometers by how near their norm at rest is to 1 g."""
    found = []
    for f in facts:
        if f.quantity != "acceleration":
            continue
        ratio = f.norm_at_rest / STANDARD_GRAVITY
        if f.unit != "m/s2":
            found.append((math.inf, f.name, f"no scale is known (unit {f.unit})"))
        elif math.isnan(ratio):
            found.append((math.inf, f.name, "no rest was found"))
        else:
            found.append((abs(ratio - 1.0), f.name, f"norm at rest = {ratio:.4f} g"))
    return tuple((name, reason) for _, name, reason in sorted(found)[:_KEPT])


def _covered(gaps: list[Gap]) -> float:
    """Seconds in which at least one sensor has a gap."""
    total, until = 0.0, -math.inf
    for gap in sorted(gaps, key=lambda g: g.start):
        total += max(0.0, gap.stop - max(gap.start, until))
        until = max(until, gap.stop)
    return total
