"""The first pass over a log that is to be fused: its rests, its busiest stretch, its clocks.

Rests give the biases anew and the noise of every axis at rest; the busiest stretch gives how the
noise grows with the rate. Memory holds what the detector of rests keeps, and that one stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.shared_gravity import check_against_gravity
from imucalib.calibration.triads import pair_triads
from imucalib.calibrators.array.board.log import nearest
from imucalib.calibrators.array.board.moving import SLOWEST
from imucalib.calibrators.array.board.rests import ATTITUDES, is_contradicted
from imucalib.calibrators.array.board.streams import Held, repeats
from imucalib.calibrators.array.fusion.fuse import find_turning, fuse
from imucalib.calibrators.array.fusion.instrument import Biases, Instrument, Stretch, along
from imucalib.calibrators.array.motion.terms import BoardMotion, board_motion
from imucalib.errors import Undetermined, UnreadableInput
from imucalib.estimators.array.noise import ChipNoise, at_rest, fit_noise
from imucalib.estimators.array.sample_age import fit_sample_age
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments, find_segments

Noise = tuple[ChipNoise, ChipNoise]  # of accelerometers and of gyros
_APART = 0.3  # share of a sample interval that simultaneous stamps may differ by
_WAIT = 1.0  # s of the clock after which a silent sensor is not waited for
_IMUS = 2  # from which there is something to fuse
_UNITS = {"acceleration": "m/s2", "angular_rate": "rad/s"}
_BUSY = 8192  # samples of the busiest stretch, at most
_FEWEST = 50  # moving samples from which noise in motion is told
_DRIFT, _REST = 1e-2, 2e-3  # m/s²: what biases do from log to log, and one rest's own error
_GROUPS = 200  # of rests, at most
#: Variance that a bias walks in the mean time between rests over what differs from rest to rest.
_SHARES = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 26)])
_USED = 2000  # moving samples of the busiest stretch that the noise is fitted to
_KEPT = 0.25  # share of its variance that a residual must keep to tell of the noise
_FIRST_GROWTH, _FIRST_TAILS = 0.5, 4.0  # of the noise before it is fitted, per rad/s and ν
_CHIPS = 6  # from which each half shows the motion with some to spare
_SURE = 1.04  # factor from which the noise is widened
_MAD = 1.4826
_READ = 4096  # samples that are fused at a time, so that memory stays small
_WINDOW = 90.0  # s over which a beat holds its frequency
_BEATEN = 200  # moving samples of a window from which its beats are sought
_ROUGH = 2  # rounds of a first look


class NotFusable(UnreadableInput):
    """The IMUs of the array are not there, or not with a scale."""


def side_by_side(blocks: Iterable[Recording], instrument: Instrument) -> Iterator[Stretch]:
    """Stretches of all IMUs of the instrument, one a block of the recording.

    The first IMU's accelerometer gives the instants. A reading belongs to the nearest one within a
    share of the interval; an IMU without one there, or with one that is held from before, takes no
    part in that sample. Raises
    UnreadableInput where no IMU is the instrument's, NotFusable where fewer than two are there with
    a gyro, and for readings that are not in SI units.
    """
    queue: _Queue | None = None
    for block in blocks:
        if not block.channels:
            continue
        if queue is None:
            queue = _Queue(block, instrument)
        queue.add(block)
        yield from queue.ready(last=False)
    if queue is not None:
        yield from queue.ready(last=True)


class _Queue:
    """Readings that wait for those of the other sensors of their instant."""

    def __init__(self, first: Recording, instrument: Instrument) -> None:
        self._count = len(instrument.triads)
        self._at = named = instrument.partner or pair_triads(instrument.triads, first).partner
        own = [c for c in first.channels.values() if c.triad in named and c.quantity in _UNITS]
        gyros = {c.triad for c in own if c.quantity == "angular_rate"}
        if len(named) < _IMUS or not gyros:
            raise NotFusable(
                f"{len(named)} accelerometers and {len(gyros)} gyros of the array are in the "
                "recording: too few to fuse",
                where=first.path,
                remedy="two IMUs and one gyro are needed; --no-fused corrects each by itself",
            )
        base = next(c for c in own if c.quantity == "acceleration")
        self._base, self._tolerance = _key(base), _APART / base.rate
        self._waiting = {_key(c): (np.empty(0), np.empty((0, 3))) for c in own}
        self._last = dict.fromkeys(self._waiting, -np.inf)
        self._ends: list[Held | None] = [None, None]

    def add(self, block: Recording) -> None:
        """Take a block; samples whose time does not go on are left out."""
        for channel in block.channels.values():
            key = _key(channel)
            if key not in self._waiting:
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
            t, values = self._waiting[key]
            self._waiting[key] = (
                np.concatenate([t, channel.t[forward]]),
                np.concatenate([values, channel.values[forward]]),
            )

    def ready(self, *, last: bool) -> Iterator[Stretch]:
        """The instants that are complete, or waited for long enough; of the last block, all."""
        clock = self._waiting[self._base][0]
        if not len(clock):
            return
        reached = min(t[-1] if len(t) else -np.inf for t, _ in self._waiting.values())
        until = np.inf if last else max(reached, clock[-1] - _WAIT)
        t = clock[: np.searchsorted(clock, until, side="right")]
        if not len(t):
            return
        found = {q: np.full((len(t), self._count, 3), np.nan) for q in _UNITS}
        for key, (own, values) in self._waiting.items():
            if len(own):
                index = nearest(own, t)
                near = np.abs(own[index] - t) <= self._tolerance
                found[key[1]][near, self._at[key[0]]] = values[index[near]]
            used = int(np.searchsorted(own, until - self._tolerance, side="right"))
            used = len(t) if key == self._base else used
            self._waiting[key] = own[used:], values[used:]
        yield self._drop_held(Stretch(t, found["acceleration"], found["angular_rate"]))

    def _drop_held(self, stretch: Stretch) -> Stretch:
        """With readings that are held from before missing."""
        speed = np.linalg.norm(stretch.rate, axis=2)
        there = np.isfinite(speed)
        speed = np.where(there, speed, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
        for kind, values in enumerate((stretch.acceleration, stretch.rate)):
            frozen, self._ends[kind] = repeats(values, speed > SLOWEST, self._ends[kind])
            values[frozen] = np.nan
        return stretch


def _key(channel: Channel) -> tuple[str, str]:
    return channel.triad, channel.quantity


@dataclass(frozen=True)
class Survey:
    """instrument : with the log's own biases; noise : of accelerometers and gyros
    rests : s of rest that gave the biases, 0 without; turned : moving samples behind the noise
    notes : how the log's sensors were paired, and how they agree on gravity"""

    instrument: Instrument
    noise: Noise
    rests: float
    turned: int
    notes: tuple[str, ...] = ()


def survey(blocks: Iterable[Recording], instrument: Instrument) -> Survey:
    """Look a recording through. Errors as in `side_by_side` and `check_against_gravity`."""
    doubt, look = instrument.doubt, _Look(replace(instrument, doubt=None))
    try:
        segments = find_segments(look.watch(blocks))
    except Undetermined:
        if look.instrument.partner is None:
            raise
        segments = None
    instrument, notes = look.instrument, look.notes
    rest = [
        np.repeat([[t.noise] for t in instrument.triads], 3, axis=1),
        np.repeat([[t.gyro_noise] for t in instrument.triads], 3, axis=1),
    ]
    seconds = 0.0 if segments is None else float(np.sum(segments.stop - segments.start))
    partner = instrument.partner
    if segments is not None and segments.n and partner:
        notes += check_against_gravity(instrument.triads, partner, segments, look.path)
        order = {k: segments.triads.index(name) for name, k in partner.items()}
        for calibrated, seen in zip(rest, (segments.noise, segments.rate_noise), strict=True):
            for k, column in order.items():
                good = np.isfinite(seen[column]) & (seen[column] > 0.0)
                calibrated[k, good] = seen[column, good]
        instrument = _add_rests(segments, order, instrument)
    noise, turned = (at_rest(rest[0]), at_rest(rest[1])), 0
    if look.busiest is not None and look.most >= _FEWEST:
        noise, turned = _noise_in_motion(instrument, look.busiest, rest)
    return Survey(replace(instrument, doubt=doubt), noise, seconds, turned, notes)


class _Look:
    """What passes by while the rests are sought: how sensors are paired, and the stretch with most
    motion, of `most` moving samples."""

    def __init__(self, instrument: Instrument) -> None:
        self.instrument, self.path, self.most = instrument, "", 0
        self.notes: tuple[str, ...] = ()
        self.busiest: Stretch | None = None

    def watch(self, blocks: Iterable[Recording]) -> Iterator[Recording]:
        """The blocks, looked at."""
        for block in blocks:
            if self.instrument.partner is None and block.channels:
                found = pair_triads(self.instrument.triads, block)
                self.notes, self.path = found.notes, block.path
                self.instrument = replace(self.instrument, partner=found.partner)
            for stretch in side_by_side([block], self.instrument):
                fast = find_turning(self.instrument, stretch)
                total = np.concatenate([[0], np.cumsum(fast)])
                width = min(_BUSY, len(fast))
                inside = total[width:] - total[: len(total) - width]
                top = int(np.argmax(inside))
                if inside[top] > self.most:
                    part = stretch.take(slice(top, top + width))
                    self.busiest = Stretch(part.t, part.acceleration.copy(), part.rate.copy())
                    self.most = int(inside[top])
            yield block


def _add_rests(segments: Segments, order: Mapping[int, int], instrument: Instrument) -> Instrument:
    """With what corrected readings hold at the rests, and without gyro effects of the force that
    the rests contradict: an effect found in motion may stand for something else there, and gravity
    in other attitudes shows whether it is one of force.

    A rest shows every gyro's bias, and what accelerometers differ by; what all of them share would
    hang on the place's gravity. The calibration's biases count as one more value of them.
    """
    middle = segments.middle
    shape = (segments.n, len(instrument.triads), 3)
    read = Stretch(middle, np.full(shape, np.nan), np.full(shape, np.nan))
    for k, column in order.items():
        read.acceleration[:, k] = segments.mean[:, column]
        read.rate[:, k] = segments.rate[:, column]
    force, rate = instrument.correct(read)
    there, turns = (np.all(np.isfinite(v), axis=2) for v in (read.acceleration, read.rate))
    whole = (there & turns).all(axis=0)
    if segments.n >= ATTITUDES and whole.any():
        motion = _still(instrument, force[:, whole].mean(axis=1))
        wrong = [
            part.term.name
            for part in instrument.beyond.parts
            if part.term.gyro
            and not part.late
            and is_contradicted(rate[:, whole], part.evaluate(motion)[:, whole])
        ]
        if wrong:
            instrument = replace(instrument, beyond=instrument.beyond.without(wrong))
    mean = (force * there[..., None]).sum(axis=1) / there.sum(axis=1)[:, None]
    apart = np.where(there[..., None], force - mean[:, None], 0.0)
    known = segments.n / (segments.n + (_REST / _DRIFT) ** 2)
    rate = rate - instrument.beyond.evaluate(_still(instrument, mean))[1]
    walk = _walk(segments, middle, np.where(turns[..., None], rate, 0.0))
    return replace(instrument, biases=Biases(known * apart.mean(axis=0), *walk))


def _still(instrument: Instrument, force: Array) -> BoardMotion:
    """The board at rest under forces (n, 3)."""
    each = np.repeat(force[:, None], len(instrument.triads), axis=1)
    return board_motion(instrument.beyond, np.arange(float(len(force))), force=each)


def _walk(segments: Segments, middle: Array, rate: Array) -> tuple[Array, Array]:
    """Times (m,) s and biases (m, K, 3) rad/s of the gyros.

    A rest's mean also holds what its attitude does to a gyro, which is no drift: the biases walk,
    rests scatter about them, and the likeliest ratio of the two (restricted likelihood, all axes
    together) says how far the walk is believed.
    """
    length = np.maximum(segments.stop - segments.start, 1e-3)
    group = np.arange(len(length)) // -(-len(length) // _GROUPS)
    weight = np.bincount(group, length)
    at = np.bincount(group, length * middle) / weight
    y = np.zeros((len(weight), rate[0].size))
    np.add.at(y, group, rate.reshape(len(rate), -1) * length[:, None])
    y /= weight[:, None]
    n, axes = y.shape
    best, found = -np.inf, y
    if n >= 3:
        walk = (np.minimum(at[:, None], at) - at[0]) / float(np.mean(np.diff(at)))
        for share in _SHARES:
            inverse = np.linalg.inv(np.eye(n) + share * walk)
            total = float(inverse.sum())
            mean = inverse.sum(axis=0) @ y / total
            off = y - mean
            square = float(np.sum(off * (inverse @ off)))
            level = axes * (np.linalg.slogdet(inverse)[1] - np.log(total))
            density = 0.5 * (level - axes * (n - 1) * np.log(max(square, 1e-300)))
            if density > best:
                best, found = density, mean + share * walk @ (inverse @ off)
    return at, np.asarray(found.reshape(n, *rate.shape[1:]))


def _noise_in_motion(instrument: Instrument, busy: Stretch, rest: list[Array]) -> tuple[Noise, int]:
    """Noise fitted to the busiest stretch, twice: the second time under the weights of the first;
    and how many samples moved."""
    first, second = (
        ChipNoise(r, np.full(len(r), _FIRST_GROWTH * float(r.mean())), _FIRST_TAILS) for r in rest
    )
    age = ages(instrument, busy, (first, second))
    moving = np.flatnonzero(find_turning(instrument, busy))
    rows = moving[np.linspace(0, len(moving) - 1, min(_USED, len(moving))).astype(np.intp)]
    some, own = busy.take(rows), None if age is None else age[rows]
    late = instrument.beyond.late(some.t, None if own is None else np.nan_to_num(own))
    for _ in range(2):
        one = fuse(instrument, some, (first, second), own, tied=False)
        speed, good = np.linalg.norm(one.motion.rate, axis=1), ~one.alone
        found = []
        doubts = one.motion.doubt(instrument.r), one.motion.doubt_of_rate(late)
        forces = one.off, one.live, one.weight, doubts[0] / first.widening, rest[0]
        rates = one.rate_off, one.rate_live, one.rate_weight, doubts[1] / second.widening, rest[1]
        for off, live, weight, doubt, still in (forces, rates):
            mean = weight.sum(axis=2) / np.maximum(live.sum(axis=2), 1)
            share = np.broadcast_to(1.0 - mean * doubt, off.shape[:2])
            kept = live & (share > _KEPT)[..., None]
            found.append(fit_noise(off[good], kept[good], share[good], speed[good], still))
        first, second = found
    some, own = some.take(slice(None, None, 2)), None if own is None else own[::2]
    return (_confirm(instrument, some, (first, second), own), second), len(moving)


def _confirm(
    instrument: Instrument, stretch: Stretch, noise: Noise, age: Array | None
) -> ChipNoise:
    """The accelerometers' noise, its growth wider by what halves of the chips differ beyond what is
    stated. Residuals of one sample are few, and heavy tails pull the motion after them, so that
    noise fitted to residuals comes out too small. Halves of the chips share no noise.

    stretch : moving samples; age : (T, K) as in `fuse`
    """
    there = np.isfinite(stretch.acceleration).all(axis=2).mean(axis=0) > 0.5
    if there.sum() < _CHIPS:
        return noise[0]
    factors, number = [], np.arange(len(there))
    for half in (number % 2 == 0, (number // 2 + number) % 2 == 0):
        one, two = (
            fuse(instrument, stretch.of_some(chips), noise, age, tied=False)
            for chips in (half, ~half)
        )
        seen = ~(one.alone | two.alone)
        doubt = np.einsum("tii->ti", one.motion.covariance + two.motion.covariance)[seen, :6]
        apart = one.motion.force - two.motion.force, one.motion.spin - two.motion.spin
        off = np.concatenate(apart, axis=1)[seen]
        factors.append(_MAD * float(np.median(np.abs(off) / np.sqrt(doubt))))
    factor = float(np.mean(factors))
    return replace(noise[0], growth=noise[0].growth * factor) if factor > _SURE else noise[0]


def ages(instrument: Instrument, stretch: Stretch, noise: Noise) -> Array | None:
    """(T, K) unit sawtooths of the readings' ages, NaN where a gyro shows no beat; None where there
    are no clocks that a log can show. A calibration says how far a reading's age swings; when,
    every log shows by itself where it moves."""
    if not instrument.clocked:
        return None
    instrument, t = replace(instrument, doubt=None), stretch.t
    found = np.full(stretch.rate.shape[:2], np.nan)
    windows = max(1, round((t[-1] - t[0]) / _WINDOW))
    edges = np.searchsorted(t, np.linspace(t[0], t[-1], windows + 1)[1:-1])
    for start, stop in zip([0, *edges], [*edges, len(t)], strict=True):
        if stop - start < _BEATEN:
            continue
        part = slice(int(start), int(stop))
        off, spin, moving = _rough(instrument, stretch.take(part), noise)
        if moving.sum() >= _BEATEN:
            clock = fit_sample_age(t[part], off, spin, np.flatnonzero(moving))
            found[part] = np.where(np.isfinite(clock.frequency), clock.wave, np.nan)
    return found


def _rough(instrument: Instrument, stretch: Stretch, noise: Noise) -> tuple[Array, Array, Flags]:
    """(T, K, 3) gyros less their mean in board axes, (T, 3) dω/dt, and which samples move with all
    of their gyros in range. Only what may move is fused."""
    off, spin = np.zeros(stretch.rate.shape), np.zeros((len(stretch.t), 3))
    moving = np.zeros(len(stretch.t), dtype=np.bool_)
    fast = np.flatnonzero(find_turning(instrument, stretch))
    back = np.asarray(np.linalg.inv(instrument.axes[1]), np.float64)
    for start in range(0, len(fast), _READ):
        rows = fast[start : start + _READ]
        one = fuse(instrument, stretch.take(rows), noise, rounds=_ROUGH, tied=False)
        seen = np.all(one.rate_live, axis=2)
        board = np.where(seen[..., None], along(back, one.rate_off), 0.0)
        mean = board.sum(axis=1) / np.maximum(seen.sum(axis=1), 1)[:, None]
        off[rows] = np.where(seen[..., None], board - mean[:, None], 0.0)
        spin[rows] = one.motion.spin
        there = np.all(np.isfinite(stretch.rate[rows]), axis=2)
        moving[rows] = np.all(seen | ~there, axis=1) & np.any(seen, axis=1)
    return off, spin, moving
