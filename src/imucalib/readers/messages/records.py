"""Logs of messages, whatever file they are in: topics, blocks of messages, and what was damaged."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.records import Schema
from numpy.typing import NDArray

from imucalib.errors import UnreadableInput
from imucalib.file_hash import sha256_of
from imucalib.recording.recording import AppliedCalibration

#: What comes before a message's payload in its record, the record's own nine bytes counted.
MESSAGE_HEAD = 31
#: Fields of a message's record.
HEAD_FIELDS: list[tuple[str, Any, int]] = [
    ("opcode", "u1", 0),
    ("length", "<u8", 1),
    ("channel", "<u2", 9),
    ("sequence", "<u4", 11),
    ("log_time", "<u8", 15),
    ("publish_time", "<u8", 23),
]


def record_type(fields: list[tuple[str, Any, int]], size: int) -> np.dtype[np.void]:
    """The type of records of `size` bytes with fields (name, numpy type, first byte)."""
    columns = {
        "names": [name for name, *_ in fields],
        "formats": [kind for _, kind, _ in fields],
        "offsets": [at for *_, at in fields],
        "itemsize": size,
    }
    return np.dtype(columns)  # type: ignore[call-overload, no-any-return]


_HEAD = record_type(HEAD_FIELDS, MESSAGE_HEAD)


@dataclass(frozen=True)
class Topic:
    """A channel of a log: its number and topic, how its messages are encoded, and their schema."""

    id: int
    name: str
    encoding: str
    schema: Schema | None
    metadata: Mapping[str, str] = field(default_factory=dict)

    @property
    def type_name(self) -> str:
        return self.schema.name if self.schema else "no schema"


@dataclass(frozen=True)
class Damage:
    """A part of the file that could not be read, or not be trusted.

    offset, size : bytes of the file; offset -1 when a container hides the place
    first_ns, last_ns : log times that the part's header claims, None when unknown
    messages : how many messages were lost, None when unknown
    """

    offset: int
    size: int
    reason: str
    first_ns: int | None = None
    last_ns: int | None = None
    messages: int | None = None

    def __str__(self) -> str:
        place = f"byte {self.offset}" if self.offset >= 0 else "a place that the index hides"
        text = f"{place}: {self.reason}"
        if self.size:
            text += f"; {self.size} bytes"
        if self.messages:
            text += f", {self.messages} messages"
        if self.first_ns is not None and self.last_ns is not None:
            text += f", {(self.last_ns - self.first_ns) * 1e-9:.6g} s of log time"
        return text + (" lost" if self.size or self.messages else "")


class RecordRows:
    """Fields of records of one type at byte positions `starts` (n,) of `data`.

    Where the positions are evenly spaced, the fields are views.
    """

    def __init__(self, data: bytes, starts: NDArray[np.int64], dtype: np.dtype[np.void]) -> None:
        self._rows: Any = starts
        shape, first, step = max(len(data) - dtype.itemsize + 1, 0), 0, 1
        steps = np.diff(starts)
        if steps.size and steps[0] > 0 and (steps == steps[0]).all():
            self._rows, shape, first, step = ..., starts.size, int(starts[0]), int(steps[0])
        self._view = np.ndarray((shape,), dtype, data, first, (step,))

    def __getitem__(self, name: str) -> NDArray[Any]:
        found: NDArray[Any] = self._view[name][self._rows]
        return found


class MessageBlock(NamedTuple):
    """Messages of one chunk (or of a stretch of a file without chunks), in file order.

    data : records of messages; starts, lengths : (n,) where each payload begins, and its bytes
    """

    data: bytes
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]

    @classmethod
    def of_records(cls, data: bytes, starts: NDArray[np.int64]) -> MessageBlock:
        """The messages whose records begin at `starts` (n,)."""
        lengths = RecordRows(data, starts, _HEAD)["length"].astype(np.int64) - (MESSAGE_HEAD - 9)
        return cls(data, starts + MESSAGE_HEAD, lengths)

    def header(self, name: str) -> NDArray[np.int64]:
        """(n,) one field of the records: channel, sequence, log_time (ns), publish_time (ns)."""
        return RecordRows(self.data, self.starts - MESSAGE_HEAD, _HEAD)[name].astype(np.int64)

    def payload(self, row: int) -> bytes:
        """The payload of one message."""
        return self.data[self.starts[row] : self.starts[row] + self.lengths[row]]

    def payloads(self) -> list[bytes]:
        """The payload of every message, for encodings that must be parsed one by one."""
        ends = (self.starts + self.lengths).tolist()
        return [self.data[a:b] for a, b in zip(self.starts.tolist(), ends, strict=True)]

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> MessageBlock:
        """The block restricted to some of its messages."""
        return self._replace(starts=self.starts[rows], lengths=self.lengths[rows])


class MessageLog(ABC):
    """A file, or a folder of files, that holds messages.

    `topics` (by channel number), `damages` and `corrections` are those of the last pass, and fill
    while it goes on. With `strict` the first damage raises UnreadableInput.
    """

    format: str

    def __init__(self, path: Path, *, strict: bool = False) -> None:
        self.path, self.strict = path, strict
        self._begin()

    def _begin(self) -> None:
        """Forget what an earlier pass found."""
        self.topics: dict[int, Topic] = {}
        self.damages: list[Damage] = []
        self.corrections: tuple[AppliedCalibration, ...] = ()

    @abstractmethod
    def blocks(self) -> Iterator[MessageBlock]:
        """Pass over the messages in file order, some thousand at a time."""

    @abstractmethod
    def indexed_topics(self) -> dict[int, Topic]:
        """Topics that the file's own index names; nothing depends on them."""

    def sha256(self) -> str:
        """SHA-256 of the content as lower-case hex."""
        return sha256_of(self.path)

    def report(self, damage: Damage) -> None:
        """Add to `damages`; raises UnreadableInput with `strict`."""
        self.damages.append(damage)
        if self.strict:
            raise UnreadableInput(
                f"damaged at {damage}",
                where=str(self.path),
                remedy="read it without the strict option to keep what is intact",
            )
