"""Readings that are not a sensor's own of that instant: lost, repeated, late by whole samples, or
spikes that no other sensor knows of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.board.log import ArrayLog
from imucalib.calibrators.array.board.moving import SLOWEST
from imucalib.errors import Undetermined

_NOTED = 0.002  # share of samples from which lost or repeated ones are noted
_FROZEN = 0.5  # share of repeated readings in motion from which a sensor does not serve
_FAR = 8  # samples by which a sensor may be late or early
_BETTER = 0.5  # of the misfit at no shift, that a shift must leave at most
#: Times what sensors of its kind leave at their best shifts, up to which one that is late by a
#: single sample is late, and not slow or late by a part of one.
_SINGLE = 2.0
#: Quantile of a sensor's distances from what the others say, and times it from which a reading is
#: none of its own.
_RARE, _SPIKE = 0.99, 10.0
_TURNING = 7  # columns of the rate's products, and of one
#: Samples of a stretch whose noise is looked at, and how many there are at least; times the next
#: noisiest from which one accelerometer alone is noisy.
_STRETCH, _FEW_STRETCHES, _NOISY = 50, 8, 4.0
_FEWEST, _MOST = 100, 1500  # moving samples that are looked at
_PLACES = 60  # at which a sensor may have lost samples
_SENSORS = ("accelerometer", "gyro")


@dataclass(frozen=True)
class Streams:
    """lost : share of the instants that the log lacks; repeated : (K, 2) share of the moving
    samples in which accelerometer and gyro read exactly what they read before; shift : (2, K, 2)
    samples by which they are late as the motion begins and as it ends, and since : (K, 2) s from
    which on, where these differ; spikes : (K, 2) moving samples in which they alone read what
    nobody else does; held : (N,) samples in motion with a repeated reading or a spike"""

    lost: float
    repeated: Array
    shift: Array
    since: Array
    spikes: Array
    held: Flags

    @property
    def notes(self) -> Iterator[str]:
        """Lost samples with their share, in words."""
        if self.lost > _NOTED:
            yield f"{100 * self.lost:.2g} % of the samples are missing from the recording"

    def find_broken(self, imus: tuple[str, ...]) -> Iterator[str]:
        """What to look at: sensors of the K IMUs whose readings repeat, with their share, or have
        spikes in motion."""
        for kind, sensor in enumerate(_SENSORS):
            for name, share in zip(imus, self.repeated[:, kind], strict=True):
                if share > _NOTED:
                    yield (
                        f"The {sensor} of {name} repeats its reading in {100 * share:.2g} % of the "
                        "moving samples, which are left out: check its bus and its supply."
                    )
            for name, count in zip(imus, self.spikes[:, kind], strict=True):
                if count:
                    yield (
                        f"The {sensor} of {name} has {count:.0f} spikes in motion, which no other "
                        "sensor knows of and which are left out: look for a broken transfer or a "
                        "loose contact."
                    )

    def refuse_late(self, imus: tuple[str, ...], interval: float) -> None:
        """Raise Undetermined for sensors that are late by whole samples, or mostly stand still."""
        wrong = []
        for kind, sensor in enumerate(_SENSORS):
            for k, name in enumerate(imus):
                own, share = self.shift[:, k, kind], self.repeated[k, kind]
                if own.any():
                    late = own[1] or own[0]
                    when = f"{'from' if own[1] else 'up to'} {self.since[k, kind]:.4g} s"
                    wrong.append(
                        f"the {sensor} of {name} is {'late' if late > 0 else 'early'} by "
                        f"{abs(late):.0f} samples ({1e3 * abs(late) * interval:.3g} ms)"
                        + (f" {when}{' on' if own[1] else ''}" if own[0] != own[1] else "")
                    )
                elif share > _FROZEN:
                    wrong.append(
                        f"the {sensor} of {name} repeats its reading in {100 * share:.0f} % of the "
                        "moving samples"
                    )
        if wrong:
            raise Undetermined(
                "; ".join(wrong),
                remedy="an array needs all sensors at the same instants: shift its stamps by so "
                "much (where its clock is its own, by more as time goes on), or take the IMU off "
                "the board file (--as-drawn goes on as it is)",
            )


def streams(log: ArrayLog) -> Streams:
    """What the samples of a log say of how they were taken."""
    missed = np.maximum(np.round(np.diff(log.t) / log.interval) - 1.0, 0.0)
    lost = float(missed.sum() / (len(log.t) + missed.sum()))
    moving = np.linalg.norm(np.median(log.rate, axis=1), axis=1) > SLOWEST
    same = np.stack([repeats(v, moving)[0] for v in (log.acceleration, log.rate)], axis=2)
    repeated = same.sum(axis=0) / max(int(moving.sum()), 1)
    spikes = _spikes(log, moving & ~log.clipped)
    held = np.asarray((same | spikes).any(axis=(1, 2)))
    shift, since = _shifts(log, moving)
    return Streams(lost, repeated, shift, since, spikes.sum(axis=0), held)


@dataclass(frozen=True)
class Held:
    """Where a stretch ends: the last readings (K, 3) of its sensors, and which (K,) are held."""

    last: Array
    held: Flags


def repeats(values: Array, moving: Flags, before: Held | None = None) -> tuple[Flags, Held]:
    """(T, K) readings (T, K, 3) that repeat what their sensor read before, in runs that reach into
    motion, and where the stretch ends: no chip that reads reads the same again while it turns.

    moving : (T,) samples in motion; before : where the stretch before ended
    """
    t, count = values.shape[:2]
    before = before or Held(np.full((count, 3), np.nan), np.zeros(count, dtype=np.bool_))
    same = np.all(values == np.concatenate([before.last[None], values[:-1]]), axis=2)
    found = np.zeros((t, count), dtype=np.bool_)
    for k, own in enumerate(same.T):
        run = np.cumsum(~own)
        frozen = np.bincount(run, own & moving) > 0
        frozen[0] |= before.held[k]
        found[:, k] = own & frozen[run]
    return found, Held(values[-1].copy(), found[-1])


def _products(rate: Array) -> Array:
    """(n, 7) squares and products of a rate (n, 3), and one: forces of a rigid board are affine in
    the place, and with few IMUs these serve for those that are missing."""
    return np.hstack([rate * rate, rate * np.roll(rate, 1, axis=1), np.ones((len(rate), 1))])


def _spikes(log: ArrayLog, looked: Flags) -> Flags:
    """(N, K, 2) of each sample the reading that is farthest from what all others of its kind say of
    it, where that is many times farther than one in a hundred is: in samples `looked` (N,). Tails
    of noise go on from there by a few times (six on measured logs), a broken transfer by hundreds,
    and a few of these are worth more than all else where noise is taken for Gaussian."""
    rows, imus = np.flatnonzero(looked), log.rate.shape[1]
    found = np.zeros((len(looked), imus, 2), dtype=np.bool_)
    width = 3 * imus + _TURNING
    if len(rows) < 5 * width:
        return found
    turning = _products(log.rate[rows].mean(axis=1))
    for kind, values in enumerate((log.acceleration, log.rate)):
        columns = np.hstack([values[rows].reshape(len(rows), -1), turning])
        kept = np.ones(len(rows), dtype=np.bool_)
        for _ in range(2):  # again without those that are found
            gram, far = columns[kept].T @ columns[kept], np.empty((len(rows), imus))
            for k in range(imus):
                own = np.arange(3 * k, 3 * k + 3)
                others = np.delete(np.arange(width), own)
                inner, along = gram[np.ix_(others, others)], gram[np.ix_(others, own)]
                slope = np.linalg.lstsq(inner, along, rcond=1e-14)[0]
                far[:, k] = np.linalg.norm(columns[:, own] - columns[:, others] @ slope, axis=1)
            far /= np.maximum(np.quantile(far[kept], _RARE, axis=0), 1e-300)
            kept = far.max(axis=1) < _SPIKE
        found[rows[~kept], far[~kept].argmax(axis=1), kind] = True
    return found


def _shifts(log: ArrayLog, moving: Flags) -> tuple[Array, Array]:
    """Samples (2, K, 2) by which each sensor is late in the first quarter of the motion and in the
    last, and (K, 2) s from which on, where these differ: a chip lost or doubled samples there."""
    count = log.rate.shape[1]
    found, since = np.zeros((2, count, 2)), np.full((count, 2), np.nan)
    rows = np.flatnonzero(moving[_FAR:-_FAR]) + _FAR
    if len(rows) < _FEWEST or count < 2:
        return found, since
    quarter = max(len(rows) // 4, _FEWEST)
    ends = [part[:: max(len(part) // _MOST, 1)] for part in (rows[:quarter], rows[-quarter:])]
    found = np.array([_shifts_in(log, part) for part in ends])
    some = rows[:: max(len(rows) // _MOST, 1)]
    for k, kind in np.argwhere(found[0] != found[1]):
        columns, seen = _predict_by_others(log, k, kind, some, found[:, k, kind].astype(np.intp))
        edges = np.linspace(0, len(some), _PLACES + 2).astype(np.intp)
        early, late = seen[:, 0], seen[:, 1]
        before = np.arange(len(some))[:, None] < edges[:, None, None]
        left = [_subtract_fit(columns, np.asarray(np.where(b, early, late))) for b in before]
        # A quarter that shows no shift may only have moved too little for it.
        place = int(np.argmin(np.linalg.norm(left, axis=(1, 2))))
        if place in (0, _PLACES + 1):
            found[:, k, kind] = found[0 if place else 1, k, kind]
        else:
            since[k, kind] = log.t[some[edges[place]]]
    return found, since


def _shifts_in(log: ArrayLog, rows: Index) -> Array:
    """(K, 2) samples by which each sensor is late in some samples: where a shift brings it far
    nearer to what the others of its kind say. Late by one sample is what then fits as well as the
    others do: a slow filter, or a lag of a part of one, does not, and is the loop's to name. An IMU
    has one clock: with one of its sensors the other is late whose best shift is the same, though it
    answers to the part of a sample that remains."""
    count = log.rate.shape[1]
    found, least = np.zeros((count, 2)), np.full((count, 2), np.inf)
    lags = np.arange(-_FAR, _FAR + 1)
    for k, kind in np.ndindex(count, 2):
        columns, seen = _predict_by_others(log, k, kind, rows, lags)
        off = _subtract_fit(columns, seen.reshape(len(rows), -1)).reshape(seen.shape)
        misfit = np.median(np.abs(off), axis=(0, 2))
        best = int(np.argmin(misfit))
        least[k, kind] = misfit[best]
        if misfit[best] < _BETTER * misfit[_FAR]:
            found[k, kind] = lags[best]
    slow = (np.abs(found) == 1.0) & (least > _SINGLE * np.median(least, axis=0))
    slow &= slow[:, ::-1] | (found != found[:, ::-1])
    return np.where(slow, 0.0, found)


def _predict_by_others(
    log: ArrayLog, k: int, kind: int, rows: Index, lags: Index
) -> tuple[Array, Array]:
    """(n, m) readings of the others of a sensor's kind, with the products of the rate and its
    change, and (n, lags, 3) its own where it is late by so many samples."""
    values = (log.acceleration, log.rate)[kind]
    others = np.arange(values.shape[1]) != k
    rate = log.rate[:, others].mean(axis=1)
    turning = _products(rate[rows]), rate[rows + 1] - rate[rows - 1]
    columns = np.hstack([values[rows][:, others].reshape(len(rows), -1), *turning])
    return columns, np.asarray(values[rows[:, None] + lags, k])


def _subtract_fit(columns: Array, seen: Array) -> Array:
    """What least squares leave."""
    return np.asarray(seen - columns @ np.linalg.lstsq(columns, seen, rcond=None)[0])


def noisy_alone(log: ArrayLog) -> int | None:
    """The accelerometer that is far noisier than all others where the board is stillest, by what
    consecutive readings differ by; None where there is none: then it is the board that shakes."""
    step = np.diff(log.acceleration, axis=0)
    parts = len(step) // _STRETCH
    if parts < _FEW_STRETCHES or step.shape[1] < 3:
        return None
    square = step[: parts * _STRETCH].reshape(parts, _STRETCH, -1, 3) ** 2
    size = np.sqrt(np.mean(square, axis=(1, 3)))
    quiet = np.argsort(np.median(size, axis=1))[: max(parts // 4, 1)]
    own = np.median(size[quiet], axis=0)
    worst = int(np.argmax(own))
    return worst if own[worst] > _NOISY * float(np.delete(own, worst).max()) else None
