"""The fused instrument in a recording: the channels of the virtual IMU, block by block."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.apply import imus_corrected, write_over
from imucalib.calibration.calibration import Calibration
from imucalib.calibration.correction import mark_of, refuse_second
from imucalib.calibrators.array.board.moving import SLOWEST
from imucalib.calibrators.array.fusion.fuse import Fused, fuse, join_blocks
from imucalib.calibrators.array.fusion.instrument import Stretch, instrument_of
from imucalib.calibrators.array.fusion.survey import Survey, ages, side_by_side, survey
from imucalib.readers import blocks, read, reader_for
from imucalib.recording.identity import demand_device
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


def fuse_stretch(found: Survey, stretch: Stretch) -> Fused:
    """The motion of a stretch of any length, a part at a time."""
    age = ages(found.instrument, stretch, found.noise)
    parts = []
    for start in range(0, len(stretch.t), _ROWS):
        stop = min(start + _ROWS, len(stretch.t))
        seen = slice(max(start - _EDGE, 0), min(stop + _EDGE, len(stretch.t)))
        own = None if age is None else age[seen]
        one = fuse(found.instrument, stretch.take(seen), found.noise, own)
        parts.append(one.take(slice(start - seen.start, stop - seen.start)))
    return join_blocks(parts)


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
        for block in blocks(source, mapping, block_samples=_BLOCK, strict=strict):
            demand_device(calibration.sensor, block)
            yield block

    def whole() -> Recording:
        (found,) = work.blocks([read(source, mapping, strict=strict)])
        return found

    found = survey(once() if again else _drop_marks(once()), instrument)
    work = _Work(calibration, found, each)
    if each and reader_for(source).name in _OF_MESSAGES:
        write_over(whole(), source, target)
    else:
        try:
            write_blocks(work.blocks(once()), target)
        except ChannelsChange:
            work = _Work(calibration, found, each)
            write(whole(), target)
    return (*work.notes, *found.notes, *work.words())


def _drop_marks(given: Iterable[Recording]) -> Iterator[Recording]:
    for block in given:
        for channel in block.channels.values():
            if channel.quantity == "acceleration":
                refuse_second(block, channel.triad)
        yield block


class _Work:
    """The second pass, and what became of the samples."""

    def __init__(self, calibration: Calibration, found: Survey, each: bool) -> None:
        self.calibration, self.found, self.each = calibration, found, each
        self.samples = self.alone = self.open = self.moving = self.timed = 0
        self.left_out = np.zeros(len(found.instrument.triads))
        self.notes: dict[str, None] = {}

    def blocks(self, given: Iterable[Recording]) -> Iterator[Recording]:
        """Blocks with the virtual IMU, alone or beside the corrected readings of every IMU."""
        for block in self._each(given) if self.each else self._alone(given):
            self.notes.update(dict.fromkeys(block.notes))
            marks = (*block.corrections, mark_of(self.calibration, TRIAD))
            yield replace(block, corrections=marks)

    def _alone(self, given: Iterable[Recording]) -> Iterator[Recording]:
        last: list[Recording] = []

        def pass_on() -> Iterator[Recording]:
            for block in given:
                last[:] = [block]
                yield block

        for stretch in side_by_side(pass_on(), self.found.instrument):
            yield replace(last[0], channels=self._channels(stretch))

    def _each(self, given: Iterable[Recording]) -> Iterator[Recording]:
        partner = self.found.instrument.partner or {}
        for block in given:
            made = imus_corrected(self.calibration, block, partner)
            channels = dict(made.channels)
            for stretch in side_by_side([block], self.found.instrument):
                channels |= self._channels(stretch)
            yield replace(made, channels=channels)

    def _channels(self, stretch: Stretch) -> dict[str, Channel]:
        """Force, rate and angular acceleration in board axes, each with the rows of its covariance,
        of the samples that are determined."""
        fused = fuse_stretch(self.found, stretch)
        keep = is_determined(fused.motion.covariance)
        self._count(fused, keep)
        motion, t = fused.motion.take(np.flatnonzero(keep)), stretch.t[keep]
        rate = 1.0 / float(np.median(np.diff(stretch.t))) if len(stretch.t) > 1 else 1.0
        made: dict[str, Channel] = {}
        for name, unit, square, values, at in (
            ("acceleration", "m/s2", "m2/s4", motion.force, 0),
            ("angular_rate", "rad/s", "rad2/s2", motion.rate, 6),
            ("angular_acceleration", "rad/s2", "rad2/s4", motion.spin, 3),
        ):
            covariance = motion.covariance[:, at : at + 3, at : at + 3].reshape(len(t), 9)
            both = (name, unit, values), (f"{name}_covariance", square, covariance)
            for quantity, own, numbers in both:
                made[f"{TRIAD}/{quantity}"] = Channel(t, numbers, own, quantity, TRIAD, rate)
        return made

    def _count(self, fused: Fused, keep: Flags) -> None:
        self.samples += len(keep)
        self.open += int((~keep).sum())
        self.alone += int(fused.alone.sum())
        whole = fused.live.all(axis=2) & fused.rate_live.all(axis=2)
        self.left_out += (~whole).sum(axis=0)
        moving = np.linalg.norm(fused.motion.rate, axis=1) > SLOWEST
        self.moving += fused.timed[moving].size
        self.timed += int(fused.timed[moving].sum())

    def words(self) -> Iterator[str]:
        """What was done, and what was done without."""
        found, instrument = self.found, self.found.instrument
        x, y, z = 1e3 * instrument.at
        known = instrument.doubt is not None
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
        if self.alone:
            yield (
                f"{self.alone} of {self.samples} samples turn faster than the gyros read: there "
                "the accelerometers give the rate"
            )
        if instrument.clocked and self.moving:
            share = 100.0 * self.timed / self.moving
            yield f"ages of the gyros' readings found in {share:.0f} % of the moving readings"
        if np.isinf(instrument.gyroscope_range):
            yield "the calibration does not say where readings clip: clipped ones take part"
        yield from self._list_lost()

    def _list_lost(self) -> Iterator[str]:
        """What is not undone, and what has no part in the result."""
        instrument, beyond = self.found.instrument, self.found.instrument.beyond
        if beyond.refuted:
            yield (
                "not applied, since the rests of this recording contradict it: "
                f"{', '.join(beyond.refuted)} (gravity in their attitudes does not move the gyros "
                "so)"
            )
        if beyond.left_out:
            names = ", ".join(beyond.left_out)
            yield f"not applied, since they belong to the calibrated log: {names}"
        if self.open:
            yield (
                f"{self.open} of {self.samples} samples left out: too many readings clip there to "
                "determine the motion"
            )
        lost = [
            f"{name} in {100.0 * n / self.samples:.1f} %"
            for name, n in zip(instrument.imus, self.left_out, strict=True)
            if n > 0.001 * self.samples
        ]
        if lost:
            yield f"clipped or missing readings left out: {', '.join(lost)}"


def is_determined(covariance: Array) -> Flags:
    """(T,) whether force and rate are known at all, by the covariances (T, 9, 9) of force, dω/dt
    and rate: what is not is left out rather than written with a value of no meaning."""
    known = [0, 1, 2, 6, 7, 8]
    variance = covariance[:, known, known]
    return np.asarray(np.all(variance < np.repeat(_OPEN, 3) ** 2, axis=1))
