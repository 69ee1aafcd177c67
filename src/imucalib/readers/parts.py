"""A clock that is set back divides a recording into parts, which follow one another in time.

A counter that begins again at zero is unrolled: no sample is missing there.

After a step back (the end of summer time, a clock that was set) the stamps name times that are
taken already. The samples stay in the file's order: a part's times are moved on so that it begins
one sample after the part before, a gap stands between them, and a note says by how much.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.errors import UnreadableInput
from imucalib.readers.timebase import FASTEST, SIDES, SLOWEST, set_back
from imucalib.recording.recording import Gap, Recording

_BACK = 1.0  # s; smaller steps are stamps out of order, which the gaps alone tell
_MOST = 100  # parts: a clock that is set back more often is no clock
#: Seconds after which counters begin again: of 16, 24 and 32 bits in s, ms, us or 100 us, of 32 in
#: ns; stamps within a minute, an hour or a day.
_PERIODS = {
    **{float(n): f"within {text}" for n, text in ((60, "a minute"), (3600, "an hour"),
                                                   (86_400, "a day"))},
    **{2.0**bits * size: f"counter of {bits} bits in {unit}"
       for unit, size in (("s", 1.0), ("ms", 1e-3), ("100 us", 1e-4), ("us", 1e-6), ("ns", 1e-9))
       for bits in (8, 16, 24, 32) if 2.0**bits * size > _BACK},
}  # fmt: skip
_LATE = 4.0  # sample steps: a counter that begins again is read within a few of them


@dataclass
class _Clock:
    """moves : how far each part is moved on, s; last, part : of each channel, its last times and
    the part that they are in; steps : of this block, the steps back that begin a part;
    periods : after which the stamps began again; dated : stamps are dates, and no counter's
    """

    moves: list[float] = field(default_factory=lambda: [0.0])
    last: dict[str, Array] = field(default_factory=dict)
    part: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    steps: set[tuple[float, float]] = field(default_factory=set)
    periods: set[float] = field(default_factory=set)
    dated: bool = False

    def keep(self, name: str, t: Array) -> None:
        """Note the end of a channel's block."""
        before = self.last.get(name, t[:0])
        self.last[name] = np.concatenate([before, t])[-SIDES:] if t.size < SIDES else t[-SIDES:]


def in_parts(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks, with every part of a clock that was set back after the part before."""
    clock = _Clock()
    for block in blocks:
        back = any(g.stop < g.start - _BACK for g in block.gaps)
        if back or len(clock.moves) > 1:
            yield _moved(block, clock)
        else:
            for name, channel in block.channels.items():
                clock.keep(name, channel.t)
            yield block


def with_plausible_clocks(blocks: Iterator[Recording]) -> Iterator[Recording]:
    """The same blocks; raises UnreadableInput for an inertial channel whose rate no such sensor
    has, and for one whose samples all have one time."""
    spans: dict[str, tuple[float, float, int, str]] = {}
    for block in blocks:
        for name, channel in block.channels.items():
            t = channel.t
            if not t.size or channel.quantity not in ("acceleration", "angular_rate"):
                continue
            low, high, count, _ = spans.get(name, (np.inf, -np.inf, 0, ""))
            low, high = min(low, float(t.min())), max(high, float(t.max()))
            spans[name] = low, high, count + t.size, block.path
            _demand_rate(name, channel.rate, count + t.size, block.path)
        yield block
    for name, (low, high, count, path) in spans.items():
        if count > 1 and not high > low:
            raise UnreadableInput(
                f"{name}: its {count} samples have one time", where=path,
                remedy="give --rate, name other stamps with --time, or their unit with --time-unit",
            )  # fmt: skip


def _demand_rate(name: str, rate: float, count: int, path: str) -> None:
    if count > 1 and not SLOWEST <= rate <= FASTEST:
        said = f"{rate:.6g} samples a second, and inertial sensors have {SLOWEST:g} to {FASTEST:g}"
        raise UnreadableInput(
            f"{name}: {said if rate > 0.0 else 'its times do not advance'}", where=path,
            remedy="name the unit of the stamps with --time-unit, other stamps with --time, or "
            "give --rate",
        )  # fmt: skip


def _moved(block: Recording, clock: _Clock) -> Recording:
    clock.notes, clock.gaps, clock.steps = [], [], set()
    clock.dated = block.start_ns is not None
    channels, parts = {}, {}
    for name, channel in block.channels.items():
        # Of a damaged log all stamps may name one moment, which tells no rate.
        step = 1.0 / channel.rate if channel.rate > 0.0 else 0.0
        parts[name] = _parts(name, channel.t, step, clock)
        channels[name] = replace(channel, t=channel.t + np.array(clock.moves)[parts[name]])
    kept = [
        _gap(g, block, parts, clock) for g in block.gaps if (g.start, g.stop) not in clock.steps
    ]
    gaps = sorted([*kept, *clock.gaps], key=lambda g: g.start)
    return replace(block, channels=channels, gaps=tuple(gaps), notes=(*block.notes, *clock.notes))


def _parts(name: str, t: Array, step: float, clock: _Clock) -> Index:
    """The part of each sample of a channel; a new part's move is found by who sees it first."""
    before = clock.last.get(name, t[:0])
    first, rows = clock.part.get(name, 0), set_back(t, before, _BACK)
    for k, row in enumerate(rows, start=first + 1):
        old, new = float(t[row - 1] if row else before[-1]), float(t[row])
        clock.steps.add((old, new))
        period = 0.0 if clock.dated else _period(old, new, step)
        if k < len(clock.moves) or (len(clock.moves) > _MOST and not period):
            continue
        if period:
            clock.moves.append(clock.moves[-1] + period)
            if period not in clock.periods:
                clock.notes.append(
                    f"the stamps begin again after {period:.10g} s ({_PERIODS[period]}): unrolled"
                )
            clock.periods.add(period)
            continue
        clock.moves.append(clock.moves[-1] + old + step - new)
        start = old + clock.moves[-2]
        said = f"the clock was set back by {old - new:.6g} s"
        clock.gaps.append(Gap(start, new + clock.moves[-1], said))
        clock.notes.append(
            f"{said} at {start:.6g} s: what follows is a part of its own, its times "
            f"moved on by {clock.moves[-1]:.6g} s"
        )
    begun = np.zeros(t.size, dtype=np.intp)
    begun[rows] = 1
    part = np.minimum(first + np.cumsum(begun), len(clock.moves) - 1)
    if t.size:
        clock.keep(name, t)
        clock.part[name] = int(part[-1])
    return np.asarray(part)


def _period(old: float, new: float, step: float) -> float:
    """The period after which stamps begin again at zero, where they do; else 0."""
    if not 0.0 <= new <= _LATE * step:
        return 0.0
    return next((p for p in _PERIODS if 0.0 < p - old + new <= _LATE * step), 0.0)


def _gap(gap: Gap, block: Recording, parts: dict[str, Index], clock: _Clock) -> Gap:
    """A gap moved with the part whose samples stand on its two sides."""
    part = max((int(p[-1]) for p in parts.values() if p.size), default=0)
    for name, channel in block.channels.items():
        at = np.flatnonzero(channel.t == gap.stop)
        inside = at[(at == 0) | (channel.t[at - 1] == gap.start)]
        if inside.size:
            part = int(parts[name][inside[0]])
            break
    move = clock.moves[part]
    return replace(gap, start=gap.start + move, stop=gap.stop + move)
