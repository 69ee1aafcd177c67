"""The IMUs of a log on one clock, block by block: what is missing stays missing, sample by sample.

The first IMU's accelerometer gives the instants. A reading belongs to the nearest one within a
share of the interval; an IMU without one there takes no part in that sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.triads import pairing_of
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.stretch import Stretch
from imucalib.errors import UnreadableInput
from imucalib.recording.recording import Channel, Recording

_APART = 0.3  # share of a sample interval that simultaneous stamps may differ by
_WAIT = 1.0  # s of the clock after which a silent sensor is not waited for
_FEWEST = 2  # IMUs from which there is something to fuse
_UNITS = {"acceleration": "m/s2", "angular_rate": "rad/s"}


class NotFusable(UnreadableInput):
    """The IMUs of the array are not there, or not with a scale."""


def side_by_side(blocks: Iterable[Recording], instrument: Instrument) -> Iterator[Stretch]:
    """Stretches of all IMUs of the instrument, one a block of the recording.

    Raises UnreadableInput where no IMU is the instrument's, NotFusable where fewer than two are
    there with a gyro, and for readings that are not in SI units.
    """
    queue: _Queue | None = None
    for block in blocks:
        if not block.channels:
            continue
        if queue is None:
            queue = _Queue(block, instrument)
        queue.add(block)
        if (ready := queue.ready()) is not None:
            yield ready
    if queue is not None and (rest := queue.ready(last=True)) is not None:
        yield rest


class _Queue:
    """Readings that wait for those of the other sensors of their instant."""

    def __init__(self, first: Recording, instrument: Instrument) -> None:
        named = instrument.partner or pairing_of(instrument.triads, first).partner
        self._count, self._at = len(instrument.triads), named
        own = [c for c in first.channels.values() if c.triad in named and c.quantity in _UNITS]
        gyros = {c.triad for c in own if c.quantity == "angular_rate"}
        if len(named) < _FEWEST or not gyros:
            raise NotFusable(
                f"{len(named)} accelerometers and {len(gyros)} gyros of the array are in the "
                "recording: too few to fuse",
                where=first.path,
                remedy="two IMUs and one gyro are needed; --no-fused corrects each by itself",
            )
        base = next(c for c in own if c.quantity == "acceleration")
        self._base, self._tolerance = _key(base), _APART / base.rate
        self._t: dict[tuple[str, str], Array] = {_key(c): np.empty(0) for c in own}
        self._values: dict[tuple[str, str], Array] = {_key(c): np.empty((0, 3)) for c in own}
        self._last = dict.fromkeys(self._t, -np.inf)

    def add(self, block: Recording) -> None:
        """Take a block; samples whose time does not go on are left out."""
        for channel in block.channels.values():
            key = _key(channel)
            if key not in self._t:
                continue
            if channel.unit != _UNITS[channel.quantity]:
                raise NotFusable(
                    f"{channel.triad}/{channel.quantity} is in {channel.unit or 'no known unit'}",
                    where=block.path,
                    remedy="state its scale in a mapping (`imucal inspect --save-mapping`)",
                )
            before = np.concatenate([[self._last[key]], channel.t])
            forward = channel.t > np.maximum.accumulate(before)[:-1]
            self._last[key] = float(before.max())
            self._t[key] = np.concatenate([self._t[key], channel.t[forward]])
            self._values[key] = np.concatenate([self._values[key], channel.values[forward]])

    def ready(self, *, last: bool = False) -> Stretch | None:
        """The instants that are complete, or waited for long enough."""
        clock = self._t[self._base]
        if not len(clock):
            return None
        reached = min(t[-1] if len(t) else -np.inf for t in self._t.values())
        until = np.inf if last else max(reached, clock[-1] - _WAIT)
        t = clock[: np.searchsorted(clock, until, side="right")]
        if not len(t):
            return None
        found = {q: np.full((len(t), self._count, 3), np.nan) for q in _UNITS}
        for (triad, quantity), own in self._t.items():
            values = self._values[triad, quantity]
            found[quantity][:, self._at[triad]] = _nearest(t, own, values, self._tolerance)
            used = int(np.searchsorted(own, until - self._tolerance, side="right"))
            if (triad, quantity) == self._base:
                used = len(t)
            self._t[triad, quantity], self._values[triad, quantity] = own[used:], values[used:]
        return Stretch(t, found["acceleration"], found["angular_rate"])


def _key(channel: Channel) -> tuple[str, str]:
    return channel.triad, channel.quantity


def _nearest(t: Array, own: Array, values: Array, tolerance: float) -> Array:
    """(T, 3) the values of the nearest instants; NaN where none is near."""
    if len(own) >= len(t) and np.array_equal(own[: len(t)], t):
        return values[: len(t)]
    if not len(own):
        return np.full((len(t), 3), np.nan)
    after = np.clip(np.searchsorted(own, t), 1, max(len(own) - 1, 1))
    after = np.minimum(after, len(own) - 1)
    before = np.maximum(after - 1, 0)
    index = np.where(np.abs(own[before] - t) <= np.abs(own[after] - t), before, after)
    near = np.abs(own[index] - t) <= tolerance
    return np.where(near[:, None], values[index], np.nan)
