"""A topic that is read: its fields, and the facts of its samples that are known after a pass."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.readers.messages.layout import FieldGroup, Groups

_PIECE = 4096  # rows of one stretch that is kept to judge the norm at rest
#: Stretches that are kept: the start in detail, the rest now and then.
_STRETCHES = (0, *range(1, 4), *(1 << k for k in range(2, 40)))
_HEAD = 1 << 15  # rows that give the sampling period

Stamps = NDArray[Any]  # int64 or float64, as the file has it


@dataclass(frozen=True)
class TopicField:
    """A quantity in a topic's messages.

    quantity : as in Channel
    address : its place as the mapping writes it; group : the numbers that make it
    unit : what the message type states, "" when it does not
    found : whether the names decided, rather than the user
    sensor : its name within messages of several sensors, else ""
    """

    quantity: str
    address: str
    group: FieldGroup
    unit: str = ""
    found: bool = True
    sensor: str = ""


@dataclass
class ClockFacts:
    """What a clock did over all samples, in its own unit; head : its first stamps."""

    count: int = 0
    first: Any = 0
    last: Any = 0
    low: Any = 0
    high: Any = 0
    zeros: int = 0
    repeats: int = 0
    backs: int = 0
    late: Any = 0  # the furthest that a stamp lies before an earlier one
    head: list[Stamps] = field(default_factory=list)

    def update(self, stamps: Stamps) -> None:
        """Add consecutive stamps; how they are divided does not matter."""
        if stamps.size == 0:
            return
        if self.count:
            steps = np.diff(stamps, prepend=self.last)
        else:
            steps = np.diff(stamps)
            self.first = self.low = self.high = stamps[0].item()
        if self.count < _HEAD:
            self.head.append(stamps[: _HEAD - self.count].copy())
        self.count += stamps.size
        self.zeros += int(stamps.size - np.count_nonzero(stamps))
        self.repeats += int(np.count_nonzero(steps == 0))
        backs = int(np.count_nonzero(steps < 0))
        if backs:
            self.backs += backs
            peaks = np.maximum(np.maximum.accumulate(stamps), self.high)
            self.late = max(self.late, (peaks - stamps).max().item())
        self.last = stamps[-1].item()
        self.low = min(self.low, stamps.min().item())
        self.high = max(self.high, stamps.max().item())


@dataclass
class TopicSource:
    """A topic that is read, and what its samples were so far.

    fields : what is read of each message; imu : whether the type is that of an IMU
    time : address of its stamp, "" for none; instant : the numbers of that
    frame : the frame_id of its first message, "" for none
    triad, origin_ns, dated : as this package's own files state them, else "", None and True
    rows : samples that were read; bad, problem : messages that could not be, and why the last
    moved : samples that were put in another order than that of the file
    more : samples beyond one a message, where messages hold lists of them
    marks : rows before which a part of the file is damaged
    alive : of each field, whether any value differs from zero
    pieces : stretches of raw samples from all over the recording, by number, each in parts
    """

    name: str
    imu: bool
    fields: tuple[TopicField, ...]
    time: str = ""
    instant: FieldGroup | None = None
    frame: str = ""
    triad: str = ""
    origin_ns: int | None = None
    dated: bool = True
    rows: int = 0
    bad: int = 0
    moved: int = 0
    more: int = 0
    problem: str = ""
    marks: list[int] = field(default_factory=list)
    stamps: ClockFacts = field(default_factory=ClockFacts)
    log: ClockFacts = field(default_factory=ClockFacts)
    alive: list[bool] = field(default_factory=list)
    pieces: dict[int, list[list[Array]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.alive = [False] * len(self.fields)

    @property
    def groups(self) -> Groups:
        """The numbers of every field, and of the stamp as the last group when there is one."""
        last = (self.instant,) if self.instant else ()
        return tuple(f.group for f in self.fields) + last

    def survey(self, samples: TopicSamples) -> None:
        """Note the facts of consecutive samples; how they are divided does not matter."""
        start, stop = self.log.count, self.log.count + samples.log.size
        self.log.update(samples.log)
        if samples.stamps is not None:
            self.stamps.update(samples.stamps)
        for i, column in enumerate(samples.columns):
            self.alive[i] = self.alive[i] or bool(column.any())
        for number in _STRETCHES:
            first, last = number * _PIECE, (number + 1) * _PIECE
            if first < stop and last > start:
                part = slice(max(first - start, 0), last - start)
                kept = [column[part].copy() for column in samples.columns]
                self.pieces.setdefault(number, []).append(kept)

    def rest_pieces(self, column: int) -> list[Array]:
        """Stretches of consecutive raw samples from all over the recording."""
        return [np.concatenate([p[column] for p in parts]) for parts in self.pieces.values()]


class TopicSamples(NamedTuple):
    """Consecutive samples of one topic, in file order.

    stamps : (n,) in the message's own unit, or None; log : (n,) ns; columns : (n, k) each
    """

    source: TopicSource
    stamps: Stamps | None
    log: NDArray[np.int64]
    columns: list[Array]
