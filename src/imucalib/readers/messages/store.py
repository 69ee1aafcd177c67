"""What the first pass keeps of each topic: always its survey, and its samples when asked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.readers.messages.lanes import Samples
from imucalib.readers.messages.survey import ClockFacts, Growing, Stamps, Survey

_BATCH = 4096  # rows that are surveyed at once when samples are not kept


class Store:
    """Samples by topic. With `keep`, whole arrays; without, only what the surveys need.

    expected : topic -> how many samples to make room for, 0 when unknown
    """

    def __init__(self, keep: bool, expected: Callable[[str], int]) -> None:
        self._expected = expected
        self.surveys: dict[str, Survey] = {}
        self._keep = keep
        self._kept: dict[str, _Kept] = {}

    def add(self, samples: Samples) -> None:
        """Add consecutive samples of one topic."""
        kept = self._kept.get(samples.topic)
        if kept is None:
            kept = self._kept[samples.topic] = _Kept(
                samples, self._expected(samples.topic) if self._keep else 0
            )
            self.surveys[samples.topic] = Survey(len(samples.columns))
        kept.append(samples)
        if not self._keep and kept.log.size >= _BATCH:
            self._survey(samples.topic)

    def close(self) -> None:
        """Finish the surveys; with `keep`, the arrays become whole one after the other."""
        for topic, kept in self._kept.items():
            kept.whole()
            self._survey(topic)

    def taken(
        self, topic: str, *, needs_stamps: bool
    ) -> tuple[Stamps | None, NDArray[np.int64], list[Array]]:
        """The kept stamps, log times and columns of a topic, handed over."""
        stamps, log, columns = self._kept.pop(topic).arrays()
        return stamps if needs_stamps else None, log, columns

    def without_stamps(self, topic: str) -> Survey:
        """The survey of a topic as if its messages had no stamp."""
        survey = self.surveys[topic]
        copy = replace(survey, stamp=ClockFacts(), head_stamp=[])
        copy.alive, copy.pieces = survey.alive, survey.pieces
        return copy

    def _survey(self, topic: str) -> None:
        stamps, log, columns = self._kept[topic].arrays()
        if log.size:
            self.surveys[topic].update(stamps, log, columns, passing=not self._keep)


class _Kept:
    """The arrays of one topic, growing until they are whole."""

    def __init__(self, first: Samples, expected: int) -> None:
        self.stamps = None
        if first.stamps is not None:
            self.stamps = Growing(None, first.stamps.dtype.type, expected)
        self.log = Growing(None, np.int64, expected)
        widths = [column.shape[1] for column in first.columns]
        self.columns = [Growing(width, np.float64, expected) for width in widths]
        self._arrays: tuple[Stamps | None, NDArray[np.int64], list[Array]] | None = None

    def append(self, samples: Samples) -> None:
        if self.stamps is not None and samples.stamps is not None:
            self.stamps.append(samples.stamps)
        self.log.append(samples.log)
        for growing, column in zip(self.columns, samples.columns, strict=True):
            growing.append(column)

    def whole(self) -> None:
        """End the growth; `arrays` then gives the same arrays every time."""
        self._arrays = self.arrays()

    def arrays(self) -> tuple[Stamps | None, NDArray[np.int64], list[Array]]:
        """What has grown, taken out."""
        if self._arrays is not None:
            return self._arrays
        stamps = self.stamps.taken() if self.stamps is not None else None
        return stamps, self.log.taken(), [column.taken() for column in self.columns]
