"""The first pass over a log that is to be fused: its rests, and its busiest stretch.

Rests give the biases anew and the noise of every axis at rest; the busiest stretch gives how the
noise grows with the rate. Memory holds what the detector of rests keeps, and that one stretch.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibration.shared_gravity import held_against_gravity
from imucalib.calibration.triads import pairing_of
from imucalib.calibrators.array.fused.biases import biases_at_rest, held_against
from imucalib.calibrators.array.fused.clocks import ages
from imucalib.calibrators.array.fused.fuse import fuse
from imucalib.calibrators.array.fused.halves import confirmed
from imucalib.calibrators.array.fused.instrument import Instrument
from imucalib.calibrators.array.fused.noise import ChipNoise, at_rest, fitted_noise
from imucalib.calibrators.array.fused.side_by_side import side_by_side
from imucalib.calibrators.array.fused.start import turning
from imucalib.calibrators.array.fused.stretch import Stretch
from imucalib.errors import Undetermined
from imucalib.recording.recording import Recording
from imucalib.rests.segments import Segments, find_segments

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
