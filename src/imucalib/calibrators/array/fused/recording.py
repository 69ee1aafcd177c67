"""The fused instrument in a recording: the channels of the virtual IMU, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.apply import imus_corrected, write_over
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.correction import mark_of, refuse_second
from imucalib.calibrators.array.fused.fuse import Fused, Stretch, fuse
from imucalib.calibrators.array.fused.instrument import instrument_of
from imucalib.calibrators.array.fused.survey import Survey, ages, side_by_side, survey
from imucalib.readers import blocks, read, reader_for
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Recording
from imucalib.units import DEG, STANDARD_GRAVITY
from imucalib.writers import ChannelsChange, write, write_blocks

TRIAD = "fused"
_BLOCK = 1 << 15  # samples of a block, so that memory is bounded by it
_ROWS = 2048  # samples that are fused at a time
_EDGE = 16  # samples that both sides of a cut see, for what neighbours tell
_OF_MESSAGES = ("mcap", "rosbag")
#: Standard deviations, m/s² and rad/s, from which on a sample is not determined by what is left of
#: its readings where most of them clip.
_OPEN = (STANDARD_GRAVITY, 500.0 * DEG)


@dataclass
class Told:
    """What became of the samples, for the notes."""

    samples: int = 0
    alone: int = 0
    open: int = 0
    left_out: Array = field(default_factory=lambda: np.zeros(0))
    moving: int = 0
    timed: int = 0

    def add(self, found: Fused, age: Array | None) -> None:
        """Count a stretch."""
        self.samples += len(found.alone)
        self.alone += int(found.alone.sum())
        out = (~(found.live.all(axis=2) & found.rate_live.all(axis=2))).sum(axis=0)
        self.left_out = out + (self.left_out if len(self.left_out) else 0)
        if age is not None:
            moving = np.linalg.norm(found.motion.rate, axis=1) > 60.0 * DEG
            self.moving += int(moving.sum()) * age.shape[1]
            self.timed += int(np.isfinite(age[moving]).sum())


def fused_stretch(found: Survey, stretch: Stretch, told: Told) -> Fused:
    """The motion of a stretch of any length, a part at a time."""
    age = ages(found.instrument, stretch, found.noise)
    parts = []
    for start in range(0, len(stretch.t), _ROWS):
        stop = min(start + _ROWS, len(stretch.t))
        first, last = max(start - _EDGE, 0), min(stop + _EDGE, len(stretch.t))
        own = None if age is None else age[first:last]
        one = fuse(found.instrument, stretch.take(slice(first, last)), found.noise, own, whole=True)
        one = one.take(slice(start - first, stop - first))
        told.add(one, None if age is None else age[start:stop])
        parts.append(one)
    return parts[0] if len(parts) == 1 else _joined(parts)


def _joined(parts: list[Fused]) -> Fused:
    first = parts[0]
    motion = replace(
        first.motion,
        **{
            n: np.concatenate([getattr(p.motion, n) for p in parts])
            for n in ("force", "spin", "rate", "covariance")
        },
    )
    names = ("off", "rate_off", "live", "rate_live", "alone")
    rest = {n: np.concatenate([getattr(p, n) for p in parts]) for n in names}
    one, two = (np.concatenate([p.weights[i] for p in parts]) for i in (0, 1))
    return replace(first, motion=motion, weights=(one, two), **rest)


def fused_channels(t: Array, found: Fused, rate: float) -> dict[str, Channel]:
    """The virtual IMU's channels: force, rate and angular acceleration in board axes, each with the
    rows of its covariance. rate : Hz"""
    motion, n = found.motion, len(t)
    made: dict[str, Channel] = {}
    for quantity, unit, square, values, at in (
        ("acceleration", "m/s2", "m2/s4", motion.force, 0),
        ("angular_rate", "rad/s", "rad2/s2", motion.rate, 6),
        ("angular_acceleration", "rad/s2", "rad2/s4", motion.spin, 3),
    ):
        inner = slice(at, at + 3)
        covariance = motion.covariance[:, inner, inner].reshape(n, 9)
        for name, u, v in (
            (quantity, unit, values),
            (f"{quantity}_covariance", square, covariance),
        ):
            made[f"{TRIAD}/{name}"] = Channel(t, v, u, name, TRIAD, rate)
    return made


def fuse_file(
    calibration: Calibration,
    source: Path,
    target: Path,
    mapping: FieldMapping,
    *,
    at: Array | None = None,
    each: bool = False,
    strict: bool = False,
    again: bool = False,
) -> tuple[str, ...]:
    """Fuse an array's recording into a file of the target's suffix; returns what there is to say.

    at : (3,) m in the drawing's frame, the point whose specific force is wanted; by default the
        middle of the IMUs
    each : also the corrected readings of every IMU
    Goes through the recording twice, block by block; with `each`, logs of messages are held whole
    as in `correct_file`. Raises UsageError where it is corrected already (unless `again`), and for
    a calibration that is no array's; otherwise as `side_by_side`.
    """
    instrument = instrument_of(calibration, at)

    def once() -> Iterator[Recording]:
        return blocks(source, mapping, block_samples=_BLOCK, strict=strict)

    found = survey(_unmarked(once(), again), instrument)
    told, notes = Told(), dict[str, None]()

    def fused_blocks(given: Iterable[Recording]) -> Iterator[Recording]:
        corrected = (
            partial(imus_corrected, calibration, partner=found.instrument.partner or {})
            if each
            else None
        )
        for block in _outputs(given, found, told, corrected):
            marks = (*block.corrections, mark_of(calibration, TRIAD))
            notes.update(dict.fromkeys(block.notes))
            yield replace(block, corrections=marks)

    if each and reader_for(source).name in _OF_MESSAGES:
        (whole,) = fused_blocks([read(source, mapping, strict=strict)])
        write_over(whole, source, target)
    else:
        try:
            write_blocks(fused_blocks(once()), target)
        except ChannelsChange:
            told, notes = Told(), {}
            (whole,) = fused_blocks([read(source, mapping, strict=strict)])
            write(whole, target)
    return (*notes, *found.notes, *_words(found, told), *_lost(found, told))


def _unmarked(given: Iterable[Recording], again: bool) -> Iterator[Recording]:
    for block in given:
        if not again:
            for channel in block.channels.values():
                if channel.quantity == "acceleration":
                    refuse_second(block, channel.triad)
        yield block


Corrected = Callable[[Recording], Recording]


def _outputs(
    given: Iterable[Recording], found: Survey, told: Told, corrected: Corrected | None
) -> Iterator[Recording]:
    """Blocks with the virtual IMU, alone or beside the others."""
    last: list[Recording] = []

    def passed() -> Iterator[Recording]:
        for block in given:
            last[:] = [block]
            yield block

    if corrected is None:
        for stretch in side_by_side(passed(), found.instrument):
            yield replace(last[0], channels=_channels(stretch, found, told))
        return
    for block in given:
        made = corrected(block)
        channels = dict(made.channels)
        for stretch in side_by_side([block], found.instrument):
            channels |= _channels(stretch, found, told)
        yield replace(made, channels=channels)


def _channels(stretch: Stretch, found: Survey, told: Told) -> dict[str, Channel]:
    step = float(np.median(np.diff(stretch.t))) if len(stretch.t) > 1 else 1.0
    fused = fused_stretch(found, stretch, told)
    keep = np.flatnonzero(determined(fused.motion.covariance))
    told.open += len(stretch.t) - len(keep)
    return fused_channels(stretch.t[keep], fused.take(keep), 1.0 / step)


def determined(covariance: Array) -> Flags:
    """(T,) whether force and rate are known at all, by the covariances (T, 9, 9) of force, dω/dt
    and rate: what is not is left out rather than written with a value of no meaning."""
    known = [0, 1, 2, 6, 7, 8]
    variance = covariance[:, known, known]
    return np.asarray(np.all(variance < np.repeat(_OPEN, 3) ** 2, axis=1))


def _words(found: Survey, told: Told) -> Iterator[str]:
    """What was done, and what was done without."""
    x, y, z = 1e3 * found.instrument.at
    known = found.instrument.doubt is not None
    yield (
        f"{TRIAD}: force at x {x:.2f}, y {y:.2f}, z {z:.2f} mm of the board's frame, rate and "
        "angular acceleration in the board's axes; covariances hold the noise"
        + (" and what the calibration leaves open" if known else ", nothing of the calibration")
    )
    if found.rests > 0.0:
        yield f"gyro biases taken anew from {found.rests:.0f} s of rest in this recording"
    else:
        yield "no rest in this recording: biases are those of the calibration"
    if found.turned:
        yield f"noise in motion from {found.turned} samples of this recording"
    else:
        yield "hardly any rotation in this recording: the noise is that at rest"
    if told.alone:
        yield (
            f"{told.alone} of {told.samples} samples turn faster than the gyros read: there the "
            "accelerometers give the rate"
        )
    if told.moving:
        share = 100.0 * told.timed / told.moving
        yield f"ages of the gyros' readings found in {share:.0f} % of the moving readings"
    if np.isinf(found.instrument.gyroscope_range):
        yield "the calibration does not say where readings clip: clipped ones take part"
    if not found.instrument.beyond.listed:
        yield "the calibration lists no effects: what needs the motion is not undone"
    if wrong := found.instrument.beyond.refuted:
        yield (
            f"not applied, since the rests of this recording contradict it: {', '.join(wrong)} "
            "(gravity in their attitudes does not move the gyros so)"
        )
    names = found.instrument.beyond.left_out
    if names:
        yield f"not applied, since they belong to the calibrated log: {', '.join(names)}"


def _lost(found: Survey, told: Told) -> Iterator[str]:
    """Samples and readings that have no part in the result."""
    if told.open:
        yield (
            f"{told.open} of {told.samples} samples left out: too many readings clip there to "
            "determine the motion"
        )
    lost = [
        f"{name} in {100.0 * n / max(told.samples, 1):.1f} %"
        for name, n in zip(found.instrument.imus, told.left_out, strict=False)
        if n > 0.001 * told.samples
    ]
    if lost:
        yield f"clipped or missing readings left out: {', '.join(lost)}"
