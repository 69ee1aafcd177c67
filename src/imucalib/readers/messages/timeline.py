"""Samples of a topic in file order to samples in time order, with their gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.readers.messages.clock import SET_BACK, TWO_PERIODS, Clock, batches, spread
from imucalib.readers.messages.survey import Stamps
from imucalib.readers.timebase import SIDES, set_back
from imucalib.recording.recording import Gap

_MOST_PARTS = 100


@dataclass
class Timeline:
    """Turns the samples of a topic, in file order, into samples in time order with gaps."""

    clock: Clock
    start_ns: int
    label: str
    missing: int = 0
    _row: int = 0
    _sent: int = 0
    _last: int | None = None
    _tail: NDArray[np.int64] | None = None
    _held: tuple[NDArray[np.int64], list[Array]] | None = None

    def push(
        self, stamps: Stamps | None, log: Stamps, columns: list[Array], marks: list[int]
    ) -> tuple[Array, list[Array], list[Gap]]:
        """Times (s), values and gaps that are final after these samples.

        marks : row numbers before which a part of the file is damaged
        """
        ns = self.clock.ns(stamps, log, self._row)
        self._row += log.size
        if self.clock.batched and ns.size:
            return self._finished(*self._spread(ns, columns), marks)
        if not self.clock.late or not ns.size:
            return self._finished(ns, columns, marks)
        done, first = list[tuple[Array, list[Array], list[Gap]]](), 0
        for row in [*self._set_back(ns), ns.size]:
            part = self._ordered(ns[first:row], [c[first:row] for c in columns])
            done.append(self._finished(*part, marks))
            rest = self.flush(marks) if row < ns.size else None
            done += [rest] if rest else []
            first = row
        t = np.concatenate([d[0] for d in done])
        joined = [np.concatenate(c) for c in zip(*(d[1] for d in done), strict=True)]
        return t, joined, [g for d in done for g in d[2]]

    def _set_back(self, ns: NDArray[np.int64]) -> list[int]:
        """Rows where the clock was set back; a message that comes late sets no clock."""
        before = self._tail if self._tail is not None else ns[:0]
        rows = set_back(ns, before, SET_BACK)
        start = rows[-1] if rows else 0
        self._tail = (ns[start:] if rows else np.concatenate([before, ns]))[-SIDES:]
        return rows if len(rows) <= _MOST_PARTS else []

    def flush(self, marks: list[int]) -> tuple[Array, list[Array], list[Gap]] | None:
        """The samples that were held back for their order, or for the next stamp."""
        held, self._held = self._held, None
        if held and self.clock.batched:
            held = spread(held[0], self.clock.period), held[1]
        return self._finished(*held, marks) if held else None

    def _spread(
        self, ns: NDArray[np.int64], columns: list[Array]
    ) -> tuple[NDArray[np.int64], list[Array]]:
        """Batches of one stamp, spread; the last waits for the stamp after it."""
        if self._held:
            ns = np.concatenate([self._held[0], ns])
            columns = [np.concatenate(p) for p in zip(self._held[1], columns, strict=True)]
        cut = int(batches(ns)[-1])
        self._held = (ns[cut:], [c[cut:] for c in columns])
        return spread(ns, self.clock.period)[:cut], [c[:cut] for c in columns]

    def _ordered(
        self, ns: NDArray[np.int64], columns: list[Array]
    ) -> tuple[NDArray[np.int64], list[Array]]:
        if self._held:
            ns = np.concatenate([self._held[0], ns])
            columns = [np.concatenate(p) for p in zip(self._held[1], columns, strict=True)]
        order = np.argsort(ns, kind="stable")
        ns, columns = ns[order], [c[order] for c in columns]
        cut = int(np.searchsorted(ns, ns[-1] - self.clock.late, side="right"))
        self._held = (ns[cut:], [c[cut:] for c in columns])
        return ns[:cut], [c[:cut] for c in columns]

    def _finished(
        self, ns: NDArray[np.int64], columns: list[Array], marks: list[int]
    ) -> tuple[Array, list[Array], list[Gap]]:
        gaps: list[Gap] = []
        if ns.size:
            gaps = self._gaps(ns, marks)
            self._sent += ns.size
            self._last = int(ns[-1])
        t = (ns - self.start_ns).astype(np.float64)
        t *= 1e-9
        return t, columns, gaps

    def _gaps(self, ns: NDArray[np.int64], marks: list[int]) -> list[Gap]:
        steps = np.diff(ns, prepend=ns[0] if self._last is None else self._last)
        period = self.clock.period
        far = steps > TWO_PERIODS * period if period else np.zeros(ns.size, dtype=np.bool_)
        broken = np.zeros(ns.size, dtype=np.bool_)
        inside = [m - self._sent for m in marks if self._sent <= m < self._sent + ns.size]
        broken[inside] = True
        long = steps > self.clock.longest
        self.missing += int(np.rint(steps[far & ~long] / period - 1).sum()) if far.any() else 0
        gaps = []
        back = steps < -SET_BACK
        for i in np.flatnonzero((far & broken) | long | back).tolist():
            stop = int(ns[i])
            reason = "a damaged part of the file" if broken[i] else "no samples"
            reason = "time steps back" if back[i] else reason
            edges = [(t - self.start_ns) * 1e-9 for t in (stop - int(steps[i]), stop)]
            gaps.append(Gap(edges[0], edges[1], f"{self.label}: {reason}"))
        return gaps
