"""The field's measures: wear, activity before and after calibration, and its own calibration.

Non-wear: an hour, in steps of a quarter, in which two of three axes scatter by less than 13 mg and
span less than 50 mg (van Hees et al. 2013, PLoS ONE 8(4) e61691, Methods, "Accelerometer data
processing"). ENMO: the mean of max(|a| - 1 g, 0) over samples (the same paper). Night: the five
hours of the mean day with the least ENMO (L5; Witting et al. 1990, Biol Psychiatry 27, 563-572).

GGIR's auto-calibration: ten-second windows whose three axes scatter by less than 13 mg, each taken
as one point; gain and offset of each axis bring the points to the unit sphere, each step a
regression of the nearest points on the present ones (van Hees et al. 2014, J Appl Physiol 117,
738-744, Appendix). It has six parameters, counts windows of one posture as independent, and states
no uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Flags
from imucalib.calibration.uncertainty import correct_readings, corrector
from imucalib.core.fit import Fit
from imucalib.data import Data
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.runs import Scan
from imucalib.units import MG, STANDARD_GRAVITY

_HOUR, _STEP, _DAY = 3600.0, 900.0, 86400.0
_SCATTER, _SPAN = 13.0 * MG, 50.0 * MG
_NIGHT = 5 * 60  # minutes
#: Share of the day that must have been seen for a night to be named.
_SEEN = 0.8
#: Of points of the field's rule: largest reading, and what each axis has to see on both sides (g).
_LARGEST, _SPAN_SEEN = 2.0 * STANDARD_GRAVITY, 0.3
_ROUNDS, _SETTLED, _NEAREST = 1000, 1e-10, 0.01
#: Samples at a time, so that what is made of them stays in the cache.
_AT_ONCE = 1 << 14
_ONE_G, _NONE = np.float32(STANDARD_GRAVITY), np.float32(0.0)


@dataclass(frozen=True)
class Wear:
    """hours : recorded, gaps left out; worn : hours of these; off : (k, 2) s, stretches without
    wear, in order"""

    hours: float
    worn: float
    off: Array

    def worn_at(self, t: Array) -> Flags:
        """(n,) whether the sensor was worn at times (n,) s."""
        inside = np.zeros(t.size, np.bool_)
        for start, stop in self.off:
            inside |= (t >= start) & (t < stop)
        return ~inside


def wear_of(scanned: Scan) -> Wear:
    """From the windows of one pass."""
    w = scanned.windows
    length = float(np.median(w.stop - w.start)) + 1.0 / scanned.rate
    middle = 0.5 * (w.start + w.stop)
    off = list[tuple[float, float]]()
    for start in np.arange(0.0, max(scanned.stop - _HOUR, 0.0) + _STEP, _STEP):
        rows = slice(*np.searchsorted(middle, [start, start + _HOUR]))
        if middle[rows].size * length < 0.5 * _HOUR:
            continue
        scatter = np.sqrt(w.variance[rows].mean(axis=0) + w.mean[rows].var(axis=0))
        span = w.high[rows].max(axis=0) - w.low[rows].min(axis=0)
        if np.sum((scatter < _SCATTER) & (span < _SPAN)) >= 2:
            begin = off.pop()[0] if off and start <= off[-1][1] else start
            off.append((begin, min(start + _HOUR, scanned.stop)))
    hours = middle.size * length / 3600.0
    lost = sum(float(np.sum((middle >= a) & (middle < b))) * length for a, b in off)
    return Wear(hours, hours - lost / 3600.0, np.array(off).reshape(-1, 2))


@dataclass(frozen=True)
class Minutes:
    """ENMO of every minute, m/s². minute : (n,) since the start; count : (n,) samples"""

    minute: Array
    count: Array
    raw: Array
    corrected: Array


class RawCorrected(Data):
    """Before and after, mg."""

    raw: float
    corrected: float


class Activity(Data):
    """What a calibration does to what is made of the recording."""

    hours_recorded: Annotated[float, "Gaps left out."]
    hours_worn: float
    not_worn_s: Annotated[Array, "Start and stop of stretches without wear."]
    night_s_of_day: Annotated[tuple[float, float] | None, "Start and stop, by its clock."]
    enmo_mg: Annotated[Mapping[str, RawCorrected], "Of worn time: day, night, all."]
    night_error_mg: Annotated[RawCorrected, "Mean error of |a| at rest at night."]
    night_posture_runs: int
    enmo_by_hour_mg: Annotated[Array, "Raw and corrected of each hour of the clock."]


def minutes_of(blocks: Iterable[Recording], triad: str, fit: Fit) -> Minutes:
    """One pass over the samples. Each is corrected by the linear part; what the rest of the
    correction does to |a| is taken at the mean of its minute, at the covariates (temperature, time,
    posture) of the posture run that is nearest in time.

    blocks : of the recording; triad : its sensor
    fit : of posture runs, in order of time
    """
    origin = correct_readings(fit, np.zeros((1, 3)))[0]
    along = correct_readings(fit, np.eye(3) * STANDARD_GRAVITY)
    slope = (along - origin).T / STANDARD_GRAVITY
    correct, time = corrector(fit), fit.observations.context["time"]
    between = 0.5 * (time[1:] + time[:-1])

    def whole(reading: Array, at: Array) -> Array:
        return correct(reading, np.searchsorted(between, at))

    parts = []
    for block in blocks:
        for channel in block.channels.values():
            if channel.quantity == "acceleration" and channel.triad == triad and channel.t.size:
                parts.append(_sum_minutes(channel, slope, origin, whole))
    rows = np.concatenate(parts) if parts else np.empty((0, 4))
    minute, place = np.unique(rows[:, 0], return_inverse=True)
    count, raw, corrected = (np.bincount(place, v).astype(np.float64) for v in rows[:, 1:].T)
    return Minutes(minute, count, raw / count, corrected / count)


def _sum_minutes(
    channel: Channel, slope: Array, origin: Array, correct: Callable[[Array, Array], Array]
) -> Array:
    """(m, 4) minute, samples, and the sums of ENMO raw and corrected, of each stretch within one
    minute; of samples in single precision, which is finer than any converter."""
    t, values = channel.t, channel.values
    minute = np.floor(t / 60.0)
    starts = np.append(0, np.flatnonzero(np.diff(minute)) + 1)
    count = np.diff(np.append(starts, t.size))
    mean = np.add.reduceat(values, starts, axis=0) / count[:, None]
    shift = np.linalg.norm(correct(mean, t[starts]), axis=1)
    shift -= np.linalg.norm(mean @ slope.T + origin, axis=1)
    turn, zero = slope.astype(np.float32), origin.astype(np.float32)[:, None]
    above = np.empty((2, t.size), np.float32)
    for a in range(0, t.size, _AT_ONCE):
        rows = slice(a, a + _AT_ONCE)
        # An axis a row: every step then runs along neighbouring numbers.
        raw = values[rows].T.astype(np.float32, order="C")
        above[0, rows], above[1, rows] = _norms(raw), _norms(turn @ raw + zero)
    above[1] += np.repeat(shift.astype(np.float32), count)
    above -= _ONE_G
    over = np.add.reduceat(np.maximum(above, _NONE, out=above), starts, axis=1, dtype=np.float64)
    return np.column_stack([minute[starts], count, *over])


def _norms(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n,) of vectors (3, n)."""
    x, y, z = vectors
    size: NDArray[np.float32] = x * x + y * y + z * z
    return np.sqrt(size, out=size)


def activity_of(
    minutes: Minutes, wear: Wear, start: float, errors: tuple[Array, Array], at: Array
) -> Activity:
    """start : s of the day at which the recording's time is zero; errors : (n,), (n,) m/s², of |a|
    raw and corrected at the posture runs of times `at` (n,) s"""
    worn = wear.worn_at(60.0 * minutes.minute + 30.0)
    clock = np.mod(60.0 * minutes.minute + 30.0 + start, _DAY)
    raw, corrected = minutes.raw / MG, minutes.corrected / MG
    night = _night(clock[worn], corrected[worn])

    def pair(rows: Flags) -> tuple[float, float]:
        weight = minutes.count[rows]
        found = (float(np.average(v[rows], weights=weight)) for v in (raw, corrected))
        return next(found), next(found)

    enmo = {"all": RawCorrected(*pair(worn))} if worn.any() else {}
    asleep = np.zeros(at.size, np.bool_)
    if night is not None:
        dark = _between(clock, night)
        parts = {"day": worn & ~dark, "night": worn & dark}
        enmo |= {name: RawCorrected(*pair(rows)) for name, rows in parts.items() if rows.any()}
        asleep = _between(np.mod(at + start, _DAY), night) & wear.worn_at(at)
    means = [float(np.mean(np.abs(e[asleep]))) / MG if asleep.any() else np.nan for e in errors]
    hour = np.floor(clock / _HOUR)
    profile = np.array(
        [pair(r) if (r := worn & (hour == h)).any() else (np.nan, np.nan) for h in range(24)]
    )
    return Activity(
        hours_recorded=wear.hours,
        hours_worn=wear.worn,
        not_worn_s=wear.off,
        night_s_of_day=night,
        enmo_mg=enmo,
        night_error_mg=RawCorrected(*means),
        night_posture_runs=int(asleep.sum()),
        enmo_by_hour_mg=profile,
    )


def _between(clock: Array, night: tuple[float, float]) -> Flags:
    return np.asarray(np.mod(clock - night[0], _DAY) < np.mod(night[1] - night[0], _DAY))


def _night(clock: Array, enmo: Array) -> tuple[float, float] | None:
    """The least active five hours of the mean day; None where too little of a day was seen."""
    place = np.floor(clock / 60.0).astype(np.intp)
    count = np.bincount(place, minlength=1440)
    if (count > 0).mean() < _SEEN:
        return None
    total = np.bincount(place, enmo, minlength=1440)
    turned = [np.concatenate([v, v[:_NIGHT]]).cumsum() for v in (total, count)]
    sums, seen = (v[_NIGHT:] - v[:-_NIGHT] for v in turned)
    # Entry k covers minutes k + 1 to k + 300.
    mean = np.where(seen > _SEEN * seen.max(), sums / np.maximum(seen, 1), np.inf)
    first = 60.0 * float(np.mod(int(np.argmin(mean)) + 1, 1440))
    return first, float(np.mod(first + 60.0 * _NIGHT, _DAY))


class ClosestPoint(Data):
    """GGIR's rule on the same recording: corrected = scale (raw + offset), in g."""

    scale: Array
    offset_g: Array
    windows: int
    error_before_mg: Annotated[float, "Mean, of |a| over these windows."]
    error_after_mg: float
    enough: Annotated[bool, "Whether every axis saw both signs beyond 0.3 g, as the rule demands."]

    def norm_error(self, reading: Array) -> Array:
        """(n,) m/s², |corrected| minus 1 g of readings (n, 3) m/s²."""
        size = np.linalg.norm(self.scale * (reading / STANDARD_GRAVITY + self.offset_g), axis=1)
        return np.asarray((size - 1.0) * STANDARD_GRAVITY, np.float64)


def closest_point(scanned: Scan) -> ClosestPoint | None:
    """The rule on the windows of a scan; None with fewer than ten of them at rest."""
    w = scanned.windows
    still = (np.sqrt(w.variance) < _SCATTER).all(axis=1) & (np.abs(w.mean) < _LARGEST).all(axis=1)
    points = w.mean[still] / STANDARD_GRAVITY
    points = points[(points**2).sum(axis=1) > 0.0]
    if len(points) < 10:
        return None
    scale, offset = _fit_closest(points)
    enough = bool(
        (points.min(axis=0) < -_SPAN_SEEN).all() and (points.max(axis=0) > _SPAN_SEEN).all()
    )
    sizes = (np.linalg.norm(p, axis=1) for p in (points, scale * (points + offset)))
    before, after = (1e3 * float(np.mean(np.abs(s - 1.0))) for s in sizes)
    return ClosestPoint(scale, offset, len(points), before, after, bool(enough))


def _fit_closest(points: Array) -> tuple[Array, Array]:
    scale, offset = np.ones(3), np.zeros(3)
    weight, last = np.ones(len(points)), np.inf
    for _ in range(_ROUNDS):
        now = scale * (points + offset)
        nearest = now / np.linalg.norm(now, axis=1, keepdims=True)
        total = weight.sum()
        centre, target = (weight @ v / total for v in (now, nearest))
        spread = weight @ np.square(now - centre)
        slope = weight @ ((now - centre) * (nearest - target)) / np.maximum(spread, 1e-12)
        shift = target - slope * centre
        offset = offset + shift / (scale * slope)
        scale = scale * slope
        away = np.linalg.norm(shift + slope * now - nearest, axis=1)
        misfit = float(weight @ away**2 / total)
        weight = np.minimum(1.0 / np.maximum(away, 1e-12), 1.0 / _NEAREST)
        if abs(misfit - last) < _SETTLED:
            break
        last = misfit
    return scale, offset
