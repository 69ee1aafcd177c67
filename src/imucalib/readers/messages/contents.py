"""The topics of a log, each with its rate and the 3-vectors of its messages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import UsageError
from imucalib.readers.contents import Content, norm_of
from imucalib.readers.messages.decode import Decoder, decoder_for
from imucalib.readers.messages.definition import LayoutError
from imucalib.readers.messages.fields import vectors_of
from imucalib.readers.messages.log import MessageLog
from imucalib.readers.messages.records import MessageBlock, Topic
from imucalib.readers.messages.select import natural

_SAMPLED = 2000  # messages of a topic that its norms are taken from, a stretch of each block
_STRETCH = 50


@dataclass
class _Seen:
    topic: Topic
    count: int = 0
    first: int = 0
    last: int = 0
    sampled: int = 0
    why: str = ""
    vectors: dict[str, tuple[str, ...]] | None = None
    values: dict[str, list[Array]] = field(default_factory=dict)
    decoder: Decoder | None = None

    def add(self, block: MessageBlock) -> None:
        """Consecutive messages of this topic."""
        times = block.header("log_time").astype(np.int64)
        self.first = min(self.first, int(times.min())) if self.count else int(times.min())
        self.last = max(self.last, int(times.max()))
        self.count += times.size
        if self.sampled >= _SAMPLED or self.why:
            return
        part = block.take(np.arange(min(_STRETCH, times.size)))
        try:
            self._sample(part)
        except (LayoutError, UsageError) as error:  # the latter: a package is missing
            self.why = str(error)
        self.sampled += part.starts.size

    def _sample(self, part: MessageBlock) -> None:
        if self.decoder is None or self.vectors is None:
            self.decoder = decoder_for(self.topic)
            self.vectors = vectors_of(self.decoder.leaves(part.payloads()[0]))
        if not self.vectors:
            return
        groups = tuple(self.vectors.values())
        decoded = self.decoder.decode(part, groups, (3,) * len(groups))
        for address, column in zip(self.vectors, decoded.columns, strict=True):
            values = column[decoded.good].astype(np.float64)
            self.values.setdefault(address, []).append(values)

    def contents(self) -> list[Content]:
        """The topic, and below it its vectors."""
        name, span = self.topic.name, (self.last - self.first) * 1e-9
        rate = (self.count - 1) / span if self.count > 1 and span > 0 else math.nan
        kind = f"{self.topic.type_name} ({self.topic.encoding or 'no encoding'})"
        own = [Content(name, kind, self.count, rate, why=self.why)]
        for address, pieces in self.values.items():
            norm = norm_of(np.concatenate(pieces))
            own.append(Content(f"{name}:{address}", "3 numbers", 0, norm=norm))
        return own


def contents_of(log: MessageLog) -> tuple[Content, ...]:
    """Every topic of a log in natural order, after one pass over it."""
    scan, hints = log.scan(strict=False), log.summary().topics
    seen: dict[int, _Seen] = {}
    for block in scan.blocks():
        channels: NDArray[np.int64] = block.header("channel").astype(np.int64)
        for number in np.flatnonzero(np.bincount(channels)).tolist():
            topic = scan.topics.get(number) or hints.get(number)
            if topic is None:
                continue
            seen.setdefault(number, _Seen(topic)).add(block.take(channels == number))
    for number, topic in {**hints, **scan.topics}.items():
        seen.setdefault(number, _Seen(topic))
    ordered = sorted(seen.values(), key=lambda s: natural(s.topic.name))
    return tuple(content for one in ordered for content in one.contents())
