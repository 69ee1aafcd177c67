"""The first pass over a log that is to be fused: its rests, and its busiest stretch.

Rests give the biases anew and the noise of every axis at rest; the busiest stretch gives how the
noise grows with the rate. Memory holds what the detector of rests keeps, and that one stretch.

The gyros' own clocks in the log that is fused: its beats, found window by window.

A calibration says how far a reading's age swings (its span); when, every log shows by itself where
it moves.

The IMUs of a log on one clock, block by block: what is missing stays missing, sample by sample.

The first IMU's accelerometer gives the instants. A reading belongs to the nearest one within a
share of the interval; an IMU without one there takes no part in that sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.shared_gravity import held_against_gravity
from imucalib.calibration.triads import pairing_of
from imucalib.calibrators.array.fused.fuse import Stretch, fuse, turning
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.noise import (
    ChipNoise,
    at_rest,
    biases_at_rest,
    fitted_noise,
    held_against,
)
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.estimators.array.sample_age import fit_sample_age
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments, find_segments

_CHIPS = 6  # chips, so that each half shows the motion with some to spare
_SURE = 1.04  # factor from which the noise is widened


_MAD = 1.4826


def confirmed(
    instrument: Instrument,
    stretch: Stretch,
    noise: tuple[ChipNoise, ChipNoise],
    age: Array | None,
) -> tuple[ChipNoise, ChipNoise]:
    """The noise, the accelerometers' growth widened by what halves differ beyond what is stated.

    stretch : moving samples; age : (T, K) as in `fuse`
    """
    there = np.isfinite(stretch.acceleration).all(axis=2).mean(axis=0) > 0.5
    if there.sum() < _CHIPS:
        return noise
    number = np.arange(len(there))
    splits = (number % 2 == 0, (number // 2 + number) % 2 == 0)
    factor = float(np.mean([_apart(instrument, stretch, noise, age, half) for half in splits]))
    if not factor > _SURE:
        return noise
    return replace(noise[0], growth=noise[0].growth * factor), noise[1]


def _apart(
    instrument: Instrument,
    stretch: Stretch,
    noise: tuple[ChipNoise, ChipNoise],
    age: Array | None,
    half: Flags,
) -> float:
    """How much more force and dω/dt of the halves differ than stated, by their median."""
    found = []
    for chips in (half, ~half):
        acceleration = np.where(chips[:, None], stretch.acceleration, np.nan)
        rate = np.where(chips[:, None], stretch.rate, np.nan)
        part = Stretch(stretch.t, acceleration, rate)
        found.append(fuse(instrument, part, noise, age, tied=False))
    one, two = (f.motion for f in found)
    seen = ~(found[0].alone | found[1].alone)
    doubt = np.einsum("tii->ti", one.covariance + two.covariance)[seen, :6]
    off = np.concatenate([one.force - two.force, one.spin - two.spin], axis=1)[seen]
    return _MAD * float(np.median(np.abs(off) / np.sqrt(doubt)))


_READ = 4096  # samples that are fused at a time, so that memory stays small
_WINDOW = 90.0  # s over which a beat holds its frequency
_BEATEN = 200  # moving samples of a window from which its beats are sought
_ROUGH = 2  # rounds of a first look


def ages(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> Array | None:
    """(T, K) unit sawtooths of the readings' ages, NaN where a gyro shows no beat; None where the
    calibration knows of none."""
    if instrument.beyond.span <= 0.0 or len(instrument.triads) < 3:
        return None
    found = np.full(stretch.rate.shape[:2], np.nan)
    t = stretch.t
    windows = max(1, round((t[-1] - t[0]) / _WINDOW))
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], windows + 1)[1:-1])
    for rows in np.split(np.arange(len(t)), edges):
        if len(rows) >= _BEATEN:
            part = slice(int(rows[0]), int(rows[-1]) + 1)
            found[part] = _of_window(instrument, stretch.take(part), noise)
    return found


def _of_window(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> Array:
    """(T, K) of one window."""
    off, spin, moving = _rough(instrument, stretch, noise)
    rows = np.flatnonzero(moving)
    if len(rows) < _BEATEN:
        return np.full(stretch.rate.shape[:2], np.nan)
    clock = fit_sample_age(stretch.t, off, spin, rows)
    return np.where(np.isfinite(clock.frequency), clock.wave, np.nan)


def _rough(
    instrument: Instrument, stretch: Stretch, noise: tuple[ChipNoise, ChipNoise]
) -> tuple[Array, Array, Flags]:
    """(T, K, 3) gyros less their mean in board axes, (T, 3) dω/dt, and which samples move with all
    of their gyros in range. Only what may move is fused."""
    t, k, _ = stretch.rate.shape
    off, spin = np.zeros((t, k, 3)), np.zeros((t, 3))
    moving = np.zeros(t, dtype=np.bool_)
    fast = np.flatnonzero(turning(instrument, stretch))
    back = np.linalg.inv(instrument.gyro_axes)
    for start in range(0, len(fast), _READ):
        rows = fast[start : start + _READ]
        one = fuse(instrument, stretch.take(rows), noise, rounds=_ROUGH, tied=False)
        board = np.einsum("kai,tki->tka", back, one.rate_off, optimize=True)
        seen = np.all(one.rate_live, axis=2)
        board = np.where(seen[..., None], board, 0.0)
        mean = board.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
        off[rows] = np.where(seen[..., None], board - mean[:, None], 0.0)
        spin[rows] = one.motion.spin
        there = np.all(np.isfinite(stretch.rate[rows]), axis=2)
        moving[rows] = np.all(seen | ~there, axis=1) & np.any(seen, axis=1)
    return off, spin, moving


_APART = 0.3  # share of a sample interval that simultaneous stamps may differ by
_WAIT = 1.0  # s of the clock after which a silent sensor is not waited for
_SAMPLES = 2  # IMUs from which there is something to fuse
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
        if len(named) < _SAMPLES or not gyros:
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


_BUSY = 8192  # samples of the busiest stretch, at most
_USED = 2000  # of its moving samples that the noise is fitted to
_FEWEST = 50  # moving samples from which noise in motion is told
_KEPT = 0.25  # share of its variance that a residual must keep to tell of the noise
_FIRST_GROWTH, _FIRST_TAILS = 0.5, 4.0  # of the noise before it is fitted, per rad/s and ν


@dataclass(frozen=True)
class Survey:
    """instrument : with the log's own biases; noise : of accelerometers and gyros
    rests : s of rest that gave the biases, 0 without; turned : moving samples behind the noise
    notes : how the log's sensors were paired, and how they agree on gravity"""

    instrument: Instrument
    noise: tuple[ChipNoise, ChipNoise]
    rests: float
    turned: int
    notes: tuple[str, ...] = ()


def survey(blocks: Iterable[Recording], instrument: Instrument) -> Survey:
    """Look a recording through. Errors as in `side_by_side` and `held_against_gravity`."""
    seen = _Seen(instrument)
    try:
        segments = find_segments(seen.watched(blocks))
    except Undetermined:
        if seen.partner is None:
            raise
        segments = None
    rest, notes = _own_noise(instrument), seen.notes
    instrument = replace(instrument, partner=seen.partner)
    if segments is not None and segments.n and seen.partner:
        notes += held_against_gravity(instrument.triads, seen.partner, segments, seen.path)
        order = {k: segments.triads.index(name) for name, k in seen.partner.items()}
        rest = _noise_at_rest(segments, order, rest)
        instrument = held_against(segments, order, instrument)
        instrument = replace(instrument, biases=biases_at_rest(segments, order, instrument))
    noise = at_rest(rest[0]), at_rest(rest[1])
    turned = 0
    if (busy := seen.busiest()) is not None:
        noise, turned = _noise_in_motion(instrument, busy, rest)
    seconds = 0.0 if segments is None else float(np.sum(segments.stop - segments.start))
    return Survey(instrument, noise, seconds, turned, notes)


class _Seen:
    """What passes by while the rests are sought: the stretch with most motion."""

    def __init__(self, instrument: Instrument) -> None:
        self._instrument = instrument
        self._best: Stretch | None = None
        self._most = 0
        self.partner: Mapping[str, int] | None = None
        self.notes: tuple[str, ...] = ()
        self.path = ""

    def watched(self, blocks: Iterable[Recording]) -> Iterator[Recording]:
        """The blocks, looked at."""
        for block in blocks:
            if self.partner is None and block.channels:
                found = pairing_of(self._instrument.triads, block)
                self.partner, self.notes, self.path = found.partner, found.notes, block.path
                self._instrument = replace(self._instrument, partner=found.partner)
            for stretch in side_by_side([block], self._instrument):
                self._look(stretch)
            yield block

    def _look(self, stretch: Stretch) -> None:
        fast = turning(self._instrument, stretch)
        total = np.concatenate([[0], np.cumsum(fast)])
        width = min(_BUSY, len(fast))
        inside = total[width:] - total[: len(total) - width]
        top = int(np.argmax(inside))
        if inside[top] > self._most:
            part = stretch.take(slice(top, top + width))
            self._best = Stretch(part.t, part.acceleration.copy(), part.rate.copy())
            self._most = int(inside[top])

    def busiest(self) -> Stretch | None:
        """None where hardly anything moves."""
        return self._best if self._most >= _FEWEST else None


def _own_noise(instrument: Instrument) -> tuple[Array, Array]:
    """(K, 3) of a sample at rest while it was calibrated."""
    return (
        np.array([np.full(3, t.noise) for t in instrument.triads]),
        np.array([np.full(3, t.gyro_noise) for t in instrument.triads]),
    )


def _noise_at_rest(
    segments: Segments, order: dict[int, int], calibrated: tuple[Array, Array]
) -> tuple[Array, Array]:
    own = [v.copy() for v in calibrated]
    for k, column in order.items():
        for which, seen in enumerate((segments.noise, segments.rate_noise)):
            good = np.isfinite(seen[column]) & (seen[column] > 0.0)
            own[which][k] = np.where(good, seen[column], own[which][k])
    return own[0], own[1]


def _noise_in_motion(
    instrument: Instrument, busy: Stretch, rest: tuple[Array, Array]
) -> tuple[tuple[ChipNoise, ChipNoise], int]:
    """Noise fitted to the busiest stretch, twice: the second time under the weights of the first;
    and how many samples moved."""
    noise = tuple(
        ChipNoise(r, np.full(len(r), _FIRST_GROWTH * float(r.mean())), _FIRST_TAILS) for r in rest
    )
    first, second = noise
    age = ages(instrument, busy, (first, second))
    moving = np.flatnonzero(turning(instrument, busy))
    rows = moving[np.linspace(0, len(moving) - 1, min(_USED, len(moving))).astype(np.intp)]
    some, own = busy.take(rows), None if age is None else age[rows]
    late = instrument.beyond.late(some.t, None if own is None else np.nan_to_num(own))
    for _ in range(2):
        one = fuse(instrument, some, (first, second), own, tied=False)
        speed = np.linalg.norm(one.motion.rate, axis=1)
        good = ~one.alone
        weigh = [
            w.sum(axis=2) / np.maximum(live.sum(axis=2), 1)
            for w, live in zip(one.weights, (one.live, one.rate_live), strict=True)
        ]
        doubt = one.motion.doubt(instrument.r) / first.widening
        turn = one.motion.doubt_of_rate(late) / second.widening
        left = 1.0 - weigh[0] * doubt, 1.0 - weigh[1] * turn
        both = ((one.off, one.live, rest[0]), (one.rate_off, one.rate_live, rest[1]))
        found = []
        for (off, live, still), own_left in zip(both, left, strict=True):
            share = np.broadcast_to(own_left, off.shape[:2])
            told = live & (share > _KEPT)[..., None]
            found.append(fitted_noise(off[good], told[good], share[good], speed[good], still))
        first, second = found
    some, own = some.take(slice(None, None, 2)), None if own is None else own[::2]
    return confirmed(instrument, some, (first, second), own), len(moving)
