"""Readings that are not a sensor's own of that instant: lost, repeated, late by whole samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibrators.array.log import ArrayLog
from imucalib.calibrators.array.moving import SLOWEST
from imucalib.errors import Undetermined

_TOLD = 0.002  # share of samples from which lost or repeated ones are told
_FROZEN = 0.5  # share of repeated readings in motion from which a sensor does not serve
_FAR = 8  # samples by which a sensor may be late or early
_BETTER = 0.5  # of the misfit at no shift, that a shift must leave at most
#: Times what sensors of its kind leave at their best shifts, up to which one that is late by a
#: single sample is late, and not slow or late by a part of one.
_ALIKE = 2.0
#: Samples of a stretch whose noise is looked at, and how many there are at least; times the next
#: noisiest from which one accelerometer alone is noisy.
_STRETCH, _FEW_STRETCHES, _NOISY = 50, 8, 4.0
_FEWEST, _MOST = 100, 1500  # moving samples that are looked at


@dataclass(frozen=True)
class Streams:
    """lost : share of the instants that the log lacks; repeated : (K, 2) share of the moving
    samples in which accelerometer and gyro read exactly what they read before; shift : (K, 2)
    samples by which they are late; held : (N,) samples in motion with a repeated reading"""

    lost: float
    repeated: Array
    shift: Array
    held: Flags


def streams(log: ArrayLog) -> Streams:
    """What the samples of a log say of how they were taken."""
    missed = np.maximum(np.round(np.diff(log.t) / log.interval) - 1.0, 0.0)
    lost = float(missed.sum() / (len(log.t) + missed.sum()))
    moving = np.linalg.norm(np.median(log.rate, axis=1), axis=1) > SLOWEST
    same = np.zeros((len(log.t), log.rate.shape[1], 2), dtype=np.bool_)
    for kind, values in enumerate((log.acceleration, log.rate)):
        same[1:, :, kind] = np.all(values[1:] == values[:-1], axis=2)
    same &= moving[:, None, None]
    repeated = same.sum(axis=0) / max(int(moving.sum()), 1)
    return Streams(lost, repeated, _shifts(log, moving), np.asarray(same.any(axis=(1, 2))))


def _shifts(log: ArrayLog, moving: Flags) -> Array:
    """(K, 2) samples by which each sensor is late: where a shift makes it far more alike what the
    others of its kind say, by least squares (forces of a rigid board are affine in the place; with
    few IMUs the products of the rate and its change stand for those that are missing). Late by one
    sample is what becomes as alike as the others are: a slow filter, or a lag of a part of one,
    does not, and is the loop's to name."""
    count = log.rate.shape[1]
    found, least = np.zeros((count, 2)), np.full((count, 2), np.inf)
    rows = np.flatnonzero(moving[_FAR:-_FAR]) + _FAR
    if len(rows) < _FEWEST or count < 2:
        return found
    rows = rows[:: max(len(rows) // _MOST, 1)]
    lags = np.arange(-_FAR, _FAR + 1)
    at = rows[:, None] + lags
    for k in range(count):
        others = np.arange(count) != k
        rate = log.rate[:, others].mean(axis=1)
        turning = np.concatenate([
            rate[rows] * rate[rows], rate[rows] * np.roll(rate[rows], 1, axis=1),
            rate[rows + 1] - rate[rows - 1], np.ones((len(rows), 1)),
        ], axis=1)  # fmt: skip
        for kind, values in enumerate((log.acceleration, log.rate)):
            told = np.concatenate([values[rows][:, others].reshape(len(rows), -1), turning], axis=1)
            seen = values[at, k].reshape(len(rows), -1)
            left = seen - told @ np.linalg.lstsq(told, seen, rcond=None)[0]
            misfit = np.median(np.abs(left.reshape(len(rows), len(lags), 3)), axis=(0, 2))
            best = int(np.argmin(misfit))
            least[k, kind] = misfit[best]
            if misfit[best] < _BETTER * misfit[_FAR]:
                found[k, kind] = lags[best]
    slow = (np.abs(found) == 1.0) & (least > _ALIKE * np.median(least, axis=0))
    return np.where(slow, 0.0, found)


def noisy_alone(log: ArrayLog) -> int | None:
    """The accelerometer that is far noisier than all others where the board is stillest, by what
    consecutive readings differ by; None where there is none: then it is the board that shakes."""
    step = np.diff(log.acceleration, axis=0)
    parts = len(step) // _STRETCH
    if parts < _FEW_STRETCHES or step.shape[1] < 3:
        return None
    size = np.sqrt(np.mean(
        step[: parts * _STRETCH].reshape(parts, _STRETCH, -1, 3) ** 2, axis=(1, 3)
    ))  # fmt: skip
    quiet = np.argsort(np.median(size, axis=1))[: max(parts // 4, 1)]
    own = np.median(size[quiet], axis=0)
    worst = int(np.argmax(own))
    return worst if own[worst] > _NOISY * float(np.delete(own, worst).max()) else None


def stream_notes(found: Streams, imus: tuple[str, ...]) -> tuple[str, ...]:
    """Lost and repeated samples with their share, in words."""
    notes = []
    if found.lost > _TOLD:
        notes.append(f"{100 * found.lost:.2g} % of the samples are missing from the recording")
    for kind, sensor in enumerate(("accelerometer", "gyro")):
        notes += [
            f"the {sensor} of {name} repeats its reading in {100 * share:.2g} % of the moving "
            "samples; these are left out"
            for name, share in zip(imus, found.repeated[:, kind], strict=True)
            if share > _TOLD
        ]
    return tuple(notes)


def refuse_streams(found: Streams, imus: tuple[str, ...], interval: float) -> None:
    """Raise Undetermined for sensors that are late by whole samples, or mostly stand still."""
    wrong = []
    for kind, sensor in enumerate(("accelerometer", "gyro")):
        own = zip(imus, found.shift[:, kind], found.repeated[:, kind], strict=True)
        for name, late, share in own:
            if late:
                wrong.append(
                    f"the {sensor} of {name} is {'late' if late > 0 else 'early'} by "
                    f"{abs(late):.0f} samples ({1e3 * abs(late) * interval:.3g} ms)"
                )
            elif share > _FROZEN:
                wrong.append(
                    f"the {sensor} of {name} repeats its reading in {100 * share:.0f} % of the "
                    "moving samples"
                )
    if wrong:
        raise Undetermined(
            "; ".join(wrong),
            remedy="an array needs all sensors at the same instants: shift its stamps by so much, "
            "or take the IMU off the board file (--as-drawn goes on as it is)",
        )
