"""Blocks of one recording back into one, files of one device into one, parts of a clock in order.

A clock that is set back divides a recording into parts, which follow one another in time. A counter
that begins again at zero is unrolled: no sample is missing there. After a step back (the end of
summer time, a clock that was set) the stamps name times that are taken already. The samples stay in
the file's order: a part's times are moved on so that it begins one sample after the part before, a
gap stands between them, and a note says by how much.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.errors import UnreadableInput, UsageError
from imucalib.readers.fields.timebase import FASTEST, SIDES, SLOWEST, set_back
from imucalib.readers.fields.words import INERTIAL
from imucalib.recording.mapping import FieldMapping
from imucalib.recording.recording import Channel, Gap, Recording

_BACK = 1.0  # s; smaller steps are stamps out of order, which a note counts
_MOST = 100  # parts: a clock that is set back more often is no clock
#: Seconds after which counters begin again: of 16, 24 and 32 bits in s, ms, us or 100 us, of 32 in
#: ns; stamps within a minute, an hour or a day.
_PERIODS = {
    **{
        float(n): f"within {text}"
        for n, text in ((60, "a minute"), (3600, "an hour"), (86_400, "a day"))
    },
    **{
        2.0**bits * size: f"counter of {bits} bits in {unit}"
        for unit, size in (("s", 1.0), ("ms", 1e-3), ("100 us", 1e-4), ("us", 1e-6), ("ns", 1e-9))
        for bits in (8, 16, 24, 32)
        if 2.0**bits * size > _BACK
    },
}
_LATE = 4.0  # sample steps: a counter that begins again is read within a few of them


def join(blocks: Iterable[Recording], where: str) -> Recording:
    """Concatenate the blocks of one file, channel by channel; notes and gaps in their order.

    Raises UnreadableInput when there is no block at all.
    """
    first: Recording | None = None
    last = first
    parts: dict[str, list[Channel]] = {}
    gaps: list[Gap] = []
    notes: list[str] = []
    for block in blocks:
        first, last = first or block, block
        for name, channel in block.channels.items():
            parts.setdefault(name, []).append(channel)
        gaps.extend(block.gaps)
        notes.extend(note for note in block.notes if note not in notes)
    if first is None or last is None:
        raise UnreadableInput(
            "the file holds no samples", where=where, remedy="check how it was recorded"
        )
    channels = {}
    for name, pieces in parts.items():
        t, values = (np.concatenate([getattr(p, part) for p in pieces]) for part in ("t", "values"))
        channels[name] = pieces[0] if len(pieces) == 1 else replace(pieces[0], t=t, values=values)
    return replace(
        first, channels=channels, gaps=tuple(gaps), notes=tuple(notes), counts=last.counts
    )


class Joined(ABC):
    """A reader whose `read` joins its blocks, of `at_once` samples each."""

    at_once = 1 << 18

    @abstractmethod
    def blocks(
        self, path: Path, mapping: FieldMapping, *, block_samples: int, strict: bool
    ) -> Iterator[Recording]:
        """See `imucalib.readers.Reader`."""

    def read(self, path: Path, mapping: FieldMapping, *, strict: bool) -> Recording:
        """Read the whole recording."""
        found = self.blocks(path, mapping, block_samples=self.at_once, strict=strict)
        return join(found, str(path))


def join_files(recordings: Sequence[Recording]) -> Recording:
    """One recording of files that one device wrote, each of other sensors, with clocks of one zero.

    Raises UsageError for a channel that two of them have, and for clocks that have no date in one
    of them or that do not overlap.
    """
    first, *others = recordings
    names = [name for one in recordings for name in one.channels]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        files = [Path(one.path).name for one in recordings if twice in one.channels]
        raise UsageError(
            f"{twice} is in {' and in '.join(files)}",
            where=first.path,
            remedy="join files of different sensors; name what each holds, or convert it alone",
        )
    if len({one.start_ns is None for one in recordings}) > 1:
        bare = next(one.path for one in recordings if one.start_ns is None)
        raise UsageError(
            "its clock has no date, those of the others have one",
            where=bare,
            remedy="join files whose stamps count from one zero",
        )
    start = min((one.start_ns for one in recordings if one.start_ns is not None), default=None)
    moved = [_shift(one, (one.start_ns or 0) - (start or 0)) for one in recordings]
    spans = [_span(one) for one in moved]
    for one, (low, high) in zip(moved[1:], spans[1:], strict=True):
        if low > spans[0][1] or high < spans[0][0]:
            raise UsageError(
                f"it spans {low:.6g} to {high:.6g} s, {first.path} {spans[0][0]:.6g} to "
                f"{spans[0][1]:.6g} s: their clocks do not overlap",
                where=one.path,
                remedy="join files of the same moments whose stamps count from one zero",
            )
    notes = [f"{Path(one.path).name}: {note}" for one in recordings for note in one.notes]
    marks = tuple(dict.fromkeys(mark for one in recordings for mark in one.corrections))
    return replace(
        first,
        channels={name: channel for one in moved for name, channel in one.channels.items()},
        path=", ".join(one.path for one in recordings),
        sha256=hashlib.sha256("".join(one.sha256 for one in recordings).encode()).hexdigest(),
        start_ns=start,
        gaps=tuple(sorted({g for one in moved for g in one.gaps}, key=lambda g: g.start)),
        notes=tuple(notes) if others else first.notes,
        mapping=first.mapping if not others else {},
        corrections=marks,
        counts=tuple(count for one in recordings for count in one.counts),
    )


def _shift(recording: Recording, ns: int) -> Recording:
    if not ns:
        return recording
    shift = ns * 1e-9
    channels = {name: replace(c, t=c.t + shift) for name, c in recording.channels.items()}
    gaps = tuple(replace(g, start=g.start + shift, stop=g.stop + shift) for g in recording.gaps)
    return replace(recording, channels=channels, gaps=gaps)


def _span(recording: Recording) -> tuple[float, float]:
    times = [c.t for c in recording.channels.values() if c.t.size]
    return min(float(t.min()) for t in times), max(float(t.max()) for t in times)


def amend_last(
    blocks: Iterable[Recording], amend: Callable[[Recording], Recording]
) -> Iterator[Recording]:
    """The same blocks, the last one amended once it is known that none follows; amend : of it"""
    last: Recording | None = None
    for block in blocks:
        if last is not None:
            yield last
        last = block
    if last is not None:
        yield amend(last)


def add_notes(recording: Recording, notes: Iterable[str]) -> Recording:
    """The recording with more notes after its own."""
    return replace(recording, notes=(*recording.notes, *notes))


def in_parts(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks, with every part of a clock that was set back after the part before."""
    clock = _Clock()
    for block in blocks:
        if len(clock.moves) > 1 or any(g.stop < g.start - _BACK for g in block.gaps):
            yield clock.move(block)
        else:
            for name, channel in block.channels.items():
                clock.keep(name, channel.t)
            yield block


@dataclass
class _Clock:
    """A clock that may be set back.

    moves : how far each part is moved on, s; last, part : of each channel, its last times and
    the part that they are in; periods : after which the stamps began again; dated : stamps are
    dates, and no counter's
    notes, gaps, steps : of this block; the steps back are those that begin a part
    """

    moves: list[float] = field(default_factory=lambda: [0.0])
    last: dict[str, Array] = field(default_factory=dict)
    part: dict[str, int] = field(default_factory=dict)
    periods: set[float] = field(default_factory=set)
    dated: bool = False
    notes: list[str] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    steps: set[tuple[float, float]] = field(default_factory=set)

    def keep(self, name: str, t: Array) -> None:
        """Note the end of a channel's block."""
        self.last[name] = np.concatenate([self.last.get(name, t[:0]), t[-SIDES:]])[-SIDES:]

    def move(self, block: Recording) -> Recording:
        """The block, each sample moved on with its part."""
        self.notes, self.gaps, self.steps = [], [], set()
        self.dated = block.start_ns is not None
        channels, parts = {}, {}
        for name, channel in block.channels.items():
            # Of a damaged log all stamps may name one moment, which tells no rate.
            step = 1.0 / channel.rate if channel.rate > 0.0 else 0.0
            parts[name] = self._parts(name, channel.t, step)
            channels[name] = replace(channel, t=channel.t + np.array(self.moves)[parts[name]])
        kept = [g for g in block.gaps if (g.start, g.stop) not in self.steps]
        gaps = [*(self._gap(g, block, parts) for g in kept), *self.gaps]
        gaps.sort(key=lambda g: g.start)
        return replace(
            block, channels=channels, gaps=tuple(gaps), notes=(*block.notes, *self.notes)
        )

    def _parts(self, name: str, t: Array, step: float) -> Index:
        """The part of each sample of a channel; a new part's move is found by who sees it first."""
        before = self.last.get(name, t[:0])
        first, rows = self.part.get(name, 0), set_back(t, before, _BACK)
        for k, row in enumerate(rows, start=first + 1):
            old, new = float(t[row - 1] if row else before[-1]), float(t[row])
            self.steps.add((old, new))
            if k >= len(self.moves):
                self._begin(old, new, step)
        begun = np.zeros(t.size, dtype=np.intp)
        begun[rows] = 1
        part = np.minimum(first + np.cumsum(begun), len(self.moves) - 1)
        if t.size:
            self.keep(name, t)
            self.part[name] = int(part[-1])
        return np.asarray(part)

    def _begin(self, old: float, new: float, step: float) -> None:
        """Begin a part after a step back from `old` to `new`."""
        # Stamps that begin again do so at zero.
        again = not self.dated and 0.0 <= new <= _LATE * step
        period = next((p for p in _PERIODS if again and 0.0 < p - old + new <= _LATE * step), 0.0)
        if period:
            self.moves.append(self.moves[-1] + period)
            if period not in self.periods:
                said = f"the stamps begin again after {period:.10g} s ({_PERIODS[period]})"
                self.notes.append(f"{said}: unrolled")
            self.periods.add(period)
        elif len(self.moves) <= _MOST:
            start = old + self.moves[-1]
            self.moves.append(self.moves[-1] + old + step - new)
            said = f"the clock was set back by {old - new:.6g} s"
            self.gaps.append(Gap(start, new + self.moves[-1], said))
            self.notes.append(
                f"{said} at {start:.6g} s: what follows is a part of its own, its times moved on "
                f"by {self.moves[-1]:.6g} s"
            )

    def _gap(self, gap: Gap, block: Recording, parts: dict[str, Index]) -> Gap:
        """A gap moved with the part whose samples are on its two sides."""
        part = max((int(p[-1]) for p in parts.values() if p.size), default=0)
        for name, channel in block.channels.items():
            at = np.flatnonzero(channel.t == gap.stop)
            inside = at[(at == 0) | (channel.t[at - 1] == gap.start)]
            if inside.size:
                part = int(parts[name][inside[0]])
                break
        return replace(gap, start=gap.start + self.moves[part], stop=gap.stop + self.moves[part])


@dataclass
class _Order:
    """A channel's times so far: how many, the least and the most; and their steps back: how many,
    and the largest, s"""

    count: int = 0
    low: float = np.inf
    high: float = -np.inf
    last: float = -np.inf
    back: int = 0
    most: float = 0.0

    def add(self, t: Array) -> None:
        """The next times."""
        steps = np.diff(t, prepend=self.last)
        self.last = float(t[-1])
        self.count += t.size
        self.low, self.high = min(self.low, float(t.min())), max(self.high, float(t.max()))
        if steps.min() < 0.0:
            self.back += int(np.count_nonzero(steps < 0.0))
            self.most = max(self.most, -float(steps.min()))


def check_clocks(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks; the last one's notes count the steps back in time that are left. Raises
    UnreadableInput for an inertial channel whose rate no such sensor has, and for one whose samples
    all have one time."""
    order: dict[str, _Order] = {}
    inertial = set[str]()

    def look(block: Recording) -> Recording:
        for name, channel in block.channels.items():
            if channel.t.size:
                one = order.setdefault(name, _Order())
                one.add(channel.t)
                if channel.quantity in INERTIAL:
                    inertial.add(name)
                    _demand_rate(name, channel.rate, one.count, block.path)
        return block

    def tell(last: Recording) -> Recording:
        for name in inertial:
            one = order[name]
            if one.count > 1 and not one.high > one.low:
                raise UnreadableInput(
                    f"{name}: its {one.count} samples have one time",
                    where=last.path,
                    remedy="give --rate, name other stamps with --time, or their unit with "
                    "--time-unit",
                )
        return add_notes(
            last,
            (
                f"{name}: {one.back} steps back in time, by up to {one.most:.3g} s"
                for name, one in order.items()
                if one.back
            ),
        )

    return amend_last(map(look, blocks), tell)


def _demand_rate(name: str, rate: float, count: int, where: str) -> None:
    """Raise UnreadableInput where samples are counted and no inertial sensor has their rate, Hz."""
    if count > 1 and not SLOWEST <= rate <= FASTEST:
        span = f"inertial sensors have {SLOWEST:g} to {FASTEST:g}"
        said = f"{rate:.6g} samples a second, and {span}"
        raise UnreadableInput(
            f"{name}: {said if rate > 0.0 else 'its times do not advance'}",
            where=where,
            remedy="name the unit of the stamps with --time-unit, other stamps with --time, or "
            "give --rate",
        )
