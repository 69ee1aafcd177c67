"""What a recording holds, before anything is calibrated: channels, clock, rest, units, losses.

And what to do about it: each line of `advice` names the option or command to use.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from imucalib.arrays import Array
from imucalib.data import Data
from imucalib.errors import ImucalError
from imucalib.question import paste
from imucalib.readers.fields.conversion import zero_g
from imucalib.readers.fields.timebase import mean_period
from imucalib.recording.recording import Channel, Gap, Recording
from imucalib.rests.candidates import refusals
from imucalib.rests.segments import Segments, find_segments
from imucalib.rests.stillness import StillSettings
from imucalib.units import STANDARD_GRAVITY

_KEPT = 10  # candidates and gaps that are listed; the rest is counted
_LOSS = re.compile(
    r"\bdamaged\b|\blost\b|cannot be (read|decoded)|did not close|may be cut|never defines"
    r"|breaks off|zero bytes|are missing|without its footer|^\d+ rows left out"
)
_REPEATS = re.compile(r"repeat the one before to the last digit")
_STEPS = 1 << 16  # steps a channel keeps for the jitter
_FAR = 0.1  # a norm at rest this far from 1 g (relative) is a wrong unit or scale, not a bad sensor
_LONG_GAPS = 0.01  # share of the recording
#: Of a worn sensor's recording, s; turns of a hand, and rests of an accelerometer alone.
_WORN, _TURNS, _RESTS = 2 * 3600.0, 5, 6


class ChannelFacts(Data):
    """One channel of a recording."""

    name: str
    quantity: str
    triad: Annotated[str, "The sensor that it is of."]
    unit: str
    samples: int
    rate_hz: Annotated[float, "Samples over time."]
    jitter_s: Annotated[float, "1.4826 times the median absolute deviation of the steps."]
    duplicates: Annotated[int, "Stamps that repeat the one before."]
    back_steps: Annotated[int, "Stamps before the one before."]
    longest_step_s: float
    low: Annotated[Array, "Least value of each axis, in the unit."]
    high: Annotated[Array, "Largest value of each axis, in the unit."]
    noise: Annotated[Array, "Of one sample of each axis at rest, in the unit; empty without rest."]
    norm_at_rest: Annotated[float, "Median over the still segments, in the unit."]
    names: Annotated[tuple[str, ...], "What the file calls the sensor: topic, dataset."] = ()


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

    def of(self, quantity: str) -> list[ChannelFacts]:
        """The channels of one quantity."""
        return [f for f in self.channels if f.quantity == quantity]


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
        axes = channel.values.T  # rows of three are slow to reduce
        self.low = np.minimum(self.low, [axis.min() for axis in axes])
        self.high = np.maximum(self.high, [axis.max() for axis in axes])

    def facts(self, name: str, still: Segments | None) -> ChannelFacts:
        """The channel, with what its rests say of it."""
        channel, noise, norm = self.example, np.empty(0), math.nan
        if still is not None and channel.triad in still.triads:
            at = still.triads.index(channel.triad)
            force = channel.quantity == "acceleration"
            own, means = (still.noise, still.mean) if force else (still.rate_noise, still.rate)
            if force or (channel.quantity == "angular_rate" and np.isfinite(own[at]).all()):
                noise = own[at]
                if still.n:
                    norm = float(np.median(np.linalg.norm(means[:, at], axis=1)))
        steps = np.concatenate(self.steps)
        steps = steps[steps > 0]
        middle = float(np.median(steps)) if steps.size else math.nan
        jitter = 1.4826 * float(np.median(np.abs(steps - middle))) if steps.size else math.nan
        return ChannelFacts(
            name=name,
            quantity=channel.quantity,
            triad=channel.triad,
            unit=channel.unit,
            samples=self.samples,
            rate_hz=1.0 / mean_period(steps, middle) if steps.size else math.nan,
            jitter_s=jitter,
            duplicates=self.duplicates,
            back_steps=self.back_steps,
            longest_step_s=self.longest,
            low=self.low,
            high=self.high,
            noise=noise,
            norm_at_rest=norm,
            names=channel.names,
        )


@dataclass
class _Watch:
    """What passes by while the still segments are sought."""

    seen: dict[str, _Running] = field(default_factory=dict)
    gaps: list[Gap] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    last: Recording | None = None

    def follow(self, blocks: Iterable[Recording]) -> Iterator[Recording]:
        """The blocks, noticed."""
        for block in blocks:
            self.last = block
            self.gaps.extend(block.gaps)
            self.notes.extend(n for n in block.notes if n not in self.notes)
            for name, channel in block.channels.items():
                if channel.t.size:
                    self.seen.setdefault(name, _Running(channel)).add(channel)
            yield block


def inspect_recording(
    blocks: Iterable[Recording], settings: StillSettings | None = None
) -> Inspection:
    """Inspect a recording given in blocks (a whole one as a list of one), in one pass.

    Raises what the blocks raise; a recording without rest or acceleration is told, not refused.
    """
    watch = _Watch()
    stream = watch.follow(blocks)
    still, why = None, ""
    try:
        still = find_segments(stream, settings)
    except ImucalError as error:
        if watch.last is None:  # nothing was read: the reader's own error
            raise
        why = error.what
    for _ in stream:  # what the detector has not read, if it gave up early
        pass
    whole, running = watch.last, watch.seen.values()
    if whole is None:
        raise ValueError("inspect_recording needs at least one block")
    facts = tuple(r.facts(name, still) for name, r in watch.seen.items())
    notes, numbered = watch.notes, {r.example.triad for r in running if r.example.numbered}
    if len(numbered) > 1:
        words = f"the file has no names for its {len(numbered)} sensors"
        notes.append(f"{words}: they are numbered in its order")
    return Inspection(
        path=whole.path,
        format=whole.format,
        sha256=whole.sha256,
        start_ns=whole.start_ns,
        span=max((r.last for r in running), default=0.0)
        - min((r.first for r in running), default=0.0),
        channels=facts,
        gaps=tuple(sorted(watch.gaps, key=lambda g: g.start - g.stop)[:_KEPT]),
        gap_count=len(watch.gaps),
        gap_seconds=_gap_seconds(watch.gaps),
        still=still,
        why_not_still=why,
        candidates=_candidates(facts),
        mapping=whole.mapping,
        notes=(*notes, *map(str, whole.counts), *(still.notes if still else ())),
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


def _gap_seconds(gaps: list[Gap]) -> float:
    """Seconds in which at least one sensor has a gap."""
    total, until = 0.0, -math.inf
    for gap in sorted(gaps, key=lambda g: g.start):
        total += max(0.0, gap.stop - max(gap.start, until))
        until = max(until, gap.stop)
    return total


def problems(found: Inspection) -> Iterator[str]:
    """What speaks against a calibration or a correction, most serious first."""
    accelerometers = found.of("acceleration")
    if not accelerometers:
        yield "there is no acceleration in it"
    unscaled = [f.triad for f in accelerometers if f.unit != "m/s2"]
    if unscaled:
        yield f"no scale is known for the acceleration of {_some(unscaled)}"
    if accelerometers and (found.still is None or not found.still.n):
        candidates = found.still.candidates if found.still else ()
        yield found.why_not_still or f"no rest in it: {refusals(candidates)}"
    off = [f.triad for f in accelerometers if f.unit == "m/s2" and _is_off(f)]
    if off:
        yield f"the norm at rest of {_some(off)} is not that of gravity"
    if found.repeats:
        held = [note.partition(":")[0] for note in found.repeats]
        yield f"samples of {_some(held)} repeat the one before (notes below)"
    if back := max((f.back_steps for f in found.channels), default=0):
        yield f"time steps back {back} time{'s' * (back != 1)} (notes below)"
    if found.losses:
        count = len(found.losses)
        yield f"part of it is lost ({count} note{'s' if count > 1 else ''} below)"
    elif found.gap_seconds > _LONG_GAPS * found.span:
        share = 100 * found.gap_seconds / found.span if found.span else 100.0
        yield f"gaps take {share:.0f} % of it"


def next_commands(found: Inspection, typed: str) -> tuple[str, ...]:
    """What to type next, and why. typed : the file and the options of its reading"""
    copies = found.still.copies() if found.still else {}
    sensors = [f for f in found.of("acceleration") if f.unit == "m/s2" and f.triad not in copies]
    if not sensors:
        return tuple(
            f"`imucal inspect {typed} --unit counts --lsb {f.norm_at_rest:.0f}`: reads it with "
            "that many counts a g."
            for f in found.of("acceleration")
            if f.norm_at_rest > 0.0
        )[:1]
    if copies or len(sensors) > 1:
        one = _of_one(found, f"{typed} {paste('--sensor', sensors[0].triad)}")
        board = (
            f"`imucal array {typed} --board BOARD -o out`: where its accelerometers are; BOARD is "
            "the drawing's file, or one of those that ship."
        )
        return one if len(sensors) == 1 else (*one, board)
    return _of_one(found, typed)


def _of_one(found: Inspection, typed: str) -> tuple[str, ...]:
    """What to type of one sensor, and why."""
    still = found.still.n if found.still else 0
    if found.span >= _WORN and still:
        return (f"`imucal actigraph {typed} -o out`: a worn sensor, by gravity at rest.",)
    if still >= _TURNS and found.of("angular_rate"):
        return (f"`imucal imu {typed} -o out`: accelerometer and gyroscope, by rests and turns.",)
    if still >= _RESTS:
        return (
            f"`imucal lab {typed} --reference norm -o out`: by gravity in its {still} rests; with "
            "a table of the angles, `--recording` of it.",
        )
    return (
        "Too few rests to calibrate: record again, two seconds of rest in each of a dozen "
        "attitudes or more, turned by hand between them.",
    )


def advice(found: Inspection) -> Iterator[tuple[str, str]]:
    """What to give or run next, and why."""
    accelerometers = found.of("acceleration")
    counts = [f for f in accelerometers if f.unit != "m/s2"]
    if counts:
        yield _scale(counts[0], found)
    if any(f.unit == "m/s2" and _is_off(f) for f in accelerometers):
        yield "--unit UNIT", "m/s2, g, mg, ug or counts, if the unit above is wrong"
    if any(f.unit == "counts" for f in found.of("angular_rate")):
        yield "--gyro-unit deg/s", "or rad/s: the file states no unit for the angular rate"
    if found.still is not None and any(c.reason for c in found.still.candidates):
        yield "--rests", "lists what came near a rest, and what refused it"
    if found.losses:
        yield "--strict", "refuses this file instead of reading what is left"
    yield "--save-mapping FILE", "keeps this reading; --mapping FILE repeats it"


def _scale(counts: ChannelFacts, found: Inspection) -> tuple[str, str]:
    """Options that give an accelerometer in counts its scale."""
    why, norm = "with --unit counts: counts a g by the data sheet", counts.norm_at_rest
    if found.still is not None and counts.triad in found.still.triads:
        away = zero_g(found.still.mean[:, found.still.triads.index(counts.triad)])
        if away is not None:
            return "--acc-offset", f"{away.sentence}; try {paste(*away.options)}"
    if not math.isfinite(norm):
        return "--lsb N", why
    return f"--lsb {norm:.0f}", f"{why}; the norm at rest is that many counts"


def _is_off(facts: ChannelFacts) -> bool:
    return abs(facts.norm_at_rest / STANDARD_GRAVITY - 1.0) > _FAR  # False for NaN: no rest


def _some(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
