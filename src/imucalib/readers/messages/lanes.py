"""Decoded messages on their way to their topics: what is read of a topic, and what waits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucalib.readers.messages.decode import Decoder
from imucalib.readers.messages.fields import TopicFields
from imucalib.readers.messages.layout import Groups


class Samples(NamedTuple):
    """Consecutive samples of one topic, in file order.

    stamps : (n,) in the message's own unit, or None; log : (n,) int64 ns; columns : (n, k) each
    """

    topic: str
    stamps: NDArray[Any] | None
    log: NDArray[np.int64]
    columns: list[NDArray[Any]]


@dataclass
class Source:
    """A topic that is read; `rows` samples so far, `marks` the rows before which damage lies."""

    name: str
    fields: TopicFields
    imu: bool
    rows: int = 0
    bad: int = 0
    problem: str = ""
    marks: list[int] = field(default_factory=list)


class DecodedRows(NamedTuple):
    """Decoded messages of several topics, in file order."""

    channels: NDArray[np.int64]
    log: NDArray[np.int64]
    stamps: NDArray[Any] | None
    columns: list[NDArray[Any]]


@dataclass
class Lane:
    """Topics that decode together: one decoder, the same groups; and what waits for division."""

    decoder: Decoder
    groups: Groups
    widths: tuple[int, ...]
    timed: bool
    waiting: list[DecodedRows] = field(default_factory=list)
    rows: int = 0


def joined_stamps(stamps: NDArray[Any]) -> NDArray[Any]:
    """(n,) stamps: seconds and nanoseconds as int64 ns, a single number as it is."""
    if stamps.shape[1] == 2:
        pair = stamps.astype(np.int64)
        total: NDArray[np.int64] = pair[:, 0] * 1_000_000_000 + pair[:, 1]
        return total
    only = stamps[:, 0]
    return only.astype(np.float64 if only.dtype.kind == "f" else np.int64)
