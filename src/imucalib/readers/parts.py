"""A clock that is set back divides a recording into parts, which follow one another in time.

After a step back (the end of summer time, a clock that was set) the stamps name times that are
taken already. The samples stay in the file's order: a part's times are moved on so that it begins
one sample after the part before, a gap stands between them, and a note says by how much.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.readers.timebase import SIDES, set_back
from imucalib.recording.recording import Gap, Recording

_BACK = 1.0  # s; smaller steps are stamps out of order, which the gaps alone tell
_MOST = 100  # parts: a clock that is set back more often is no clock


@dataclass
class _Clock:
    """moves : how far each part is moved on, s; last, part : of each channel, its last times and
    the part that they are in; steps : of this block, the steps back that begin a part
    """

    moves: list[float] = field(default_factory=lambda: [0.0])
    last: dict[str, Array] = field(default_factory=dict)
    part: dict[str, int] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    steps: set[tuple[float, float]] = field(default_factory=set)

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


def _moved(block: Recording, clock: _Clock) -> Recording:
    clock.notes, clock.gaps, clock.steps = [], [], set()
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
        if k < len(clock.moves) or len(clock.moves) > _MOST:
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
