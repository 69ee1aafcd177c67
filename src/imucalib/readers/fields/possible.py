"""What a sensor can read: samples that stand for no value, or that no accelerometer reads, are left
out and counted, whatever the format."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Flags
from imucalib.readers.fields.joining import add_notes, amend_last
from imucalib.readers.fields.timebase import find_gaps, measure_steps
from imucalib.recording.recording import Channel, Count, Gap, Recording
from imucalib.units import STANDARD_GRAVITY

#: m/s². Accelerometers that rest in gravity for a calibration end far below it.
_MOST = 1000.0 * STANDARD_GRAVITY
_FEW = 0.5  # share of a block: more is no sample that went wrong, but a wrong unit


def drop_impossible(blocks: Iterable[Recording]) -> Iterator[Recording]:
    """The same blocks without such samples of accelerometers and gyroscopes; the last one's notes
    and counts say how many there were."""
    found: dict[str, _Impossible] = {}

    def leave_out(block: Recording) -> Recording:
        channels, gaps = dict(block.channels), list(block.gaps)
        for name, channel in block.channels.items():
            if channel.quantity in ("acceleration", "angular_rate") and channel.t.size:
                one = found.setdefault(name, _Impossible())
                channels[name], new = one.without(channel)
                gaps += new
        return replace(block, channels=channels, gaps=tuple(gaps))

    def tell(last: Recording) -> Recording:
        notes = (note for name, one in found.items() for note in one.words(name))
        counts = tuple(_count(c, found, last) for c in last.counts)
        return add_notes(replace(last, counts=counts), notes)

    return amend_last(map(leave_out, blocks), tell)


@dataclass
class _Impossible:
    """Samples that were left out of a channel: without a value, and beyond what can be."""

    missing: int = 0
    beyond: int = 0

    def without(self, channel: Channel) -> tuple[Channel, list[Gap]]:
        """The channel without them, and the gaps that they leave."""
        values, most = channel.values, _MOST if channel.unit == "m/s2" else np.inf
        low, high = values.min(), values.max()
        if low >= -most and high <= most:
            return channel, []
        none: Flags = np.logical_not(np.isfinite(values).all(axis=1))
        beyond: Flags = np.logical_and(~none, (np.abs(values) > most).any(axis=1))
        if np.count_nonzero(beyond) > _FEW * beyond.size:
            beyond = np.zeros_like(beyond)
        left = none | beyond
        self.missing += int(np.count_nonzero(none))
        self.beyond += int(np.count_nonzero(beyond))
        t, rows = channel.t[~left], np.flatnonzero(~left).astype(np.float64)
        steps = measure_steps([t])
        gaps = find_gaps(t, rows, steps.threshold, None) if steps else []
        lacking = [gap for gap in gaps if gap.reason == "values missing"]
        return replace(channel, t=t, values=channel.values[~left]), lacking

    def words(self, name: str) -> Iterator[str]:
        """What there is to say of them."""
        if self.missing:
            yield f"{name}: {self.missing} samples without a value left out"
        if self.beyond:
            yield f"{name}: {self.beyond} samples beyond 1000 g, which none reads, left out"


def _count(count: Count, found: dict[str, _Impossible], last: Recording) -> Count:
    """A count with what was left out of its channels."""
    own = [
        one
        for name, one in found.items()
        if name in count.source
        or any(n in count.source for n in getattr(last.channels.get(name), "names", ()))
    ]
    lost = max((one.missing + one.beyond for one in own), default=0)
    if not lost:
        return count
    left = {**count.left, "that no sensor reads": lost}
    return replace(count, read=count.read - lost, left=left)
