"""From a recording to the turns between its rests.

A turn goes from the middle of a rest to the middle of the next one. Nothing rests wholly: a hand
creeps, and the ends of a rest are slow motion. What turns there is followed by the gyroscope as far
as it stands out of its noise: the rate beside the rest's own is shrunk, second by second, as James
and Stein (1961) shrink a mean of many numbers, to none where it is noise. So a rest on a table is
averaged whole, and one in the hand is carried to its middle before it is averaged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.calibration.gyroscope import at_times
from imucalib.core.effect import Context
from imucalib.errors import Undetermined, UnreadableInput, UsageError
from imucalib.estimators.carried import attitudes, between
from imucalib.estimators.rounding import rounding_sd
from imucalib.estimators.turn_log import Turn, TurnLog
from imucalib.recording.recording import Channel, Recording
from imucalib.recording.sensors import angular_rate
from imucalib.rests.segments import Segments
from imucalib.units import DEG, STANDARD_GRAVITY

#: s of motion beyond which the bias is not known well enough within a turn.
_LONGEST = 15.0
#: s of the parts of a rest that are shrunk together, and of the means within.
_SECTION, _PART = 1.0, 0.1
#: Turns that a calibration needs: five fix nine gains, twice that say how well.
FEWEST = 6
#: rad, of gravity, below which a turn says nothing of the gains.
_TILT = 10.0 * DEG


@dataclass(frozen=True)
class LogCourse:
    """What effects may follow. begin, span : (L,) s, of each log; time : (N,) s and warm : (N,) °C,
    of the rests, None without a thermometer in each log; gravity : m/s²; rests : what those of an
    accelerometer may, which know a log by its rests alone"""

    begin: Array
    span: Array
    time: Array
    warm: Array | None
    gravity: float = STANDARD_GRAVITY
    rests: Context = field(default_factory=lambda: Context(0))

    def context(self, t: Array) -> Context:
        """At times (n,) s: a log's own clock, for logs one after another are no time series."""
        log = np.maximum(np.searchsorted(self.begin, t, side="right") - 1, 0)
        own = t - self.begin[log]
        known = {"order": own / self.span[log], "time": own}
        if self.warm is not None:
            known["temperature"] = np.interp(t, self.time, self.warm)
        return Context(len(t), known, moving=True)


@dataclass(frozen=True)
class ImuLog:
    """A log of one IMU, or several: what is fitted, and what was left out of it.

    left_out : one sentence a turn
    """

    turns: TurnLog
    left_out: tuple[str, ...]
    course: LogCourse


def gyroscope_of(recording: Recording, triad: str) -> Channel:
    """The angular rate of the IMU. Raises UsageError where there is none, UnreadableInput where it
    has no scale."""
    own = angular_rate(recording, triad)
    if own is None:
        raise UsageError(
            "the recording has no gyroscope, and there is nothing to calibrate beside the "
            "accelerometer",
            where=recording.path,
            remedy="name its columns with --gyro X,Y,Z; `imucal lab --reference norm` calibrates "
            "an accelerometer alone",
        )
    if own.unit != "rad/s":
        raise UnreadableInput(
            f"the angular rate has no scale (unit {own.unit})",
            where=recording.path,
            remedy="state it with --gyro-unit rad/s or deg/s, or --gyro-unit counts --gyro-lsb N "
            "(counts a deg/s)",
        )
    return own


def imu_of(recordings: Sequence[Recording], segments: Sequence[Segments], gravity: float) -> ImuLog:
    """The turns of one IMU's logs, its acceleration as it was read.

    Raises as `gyroscope_of`, and Undetermined where too few turns can be used, with why.
    """
    logs = [_of_one(r, s, gravity) for r, s in zip(recordings, segments, strict=True)]
    whole = logs[0] if len(logs) == 1 else _together(logs)
    force = whole.turns.force
    tilts = [float(between(*force[t.rest : t.rest + 2])) for t in whole.turns.turns]
    if sum(tilt > _TILT for tilt in tilts) < FEWEST:
        why = f"; {len(whole.left_out)} left out: {whole.left_out[0]}" if whole.left_out else ""
        few = f"{len(tilts)} turns between rests can be used"
        vertical = f", {sum(t <= _TILT for t in tilts)} of them about the vertical" if tilts else ""
        raise Undetermined(
            f"{few}{vertical}{why}",
            where=recordings[0].path,
            remedy="the gyroscope shows by how it carries gravity from rest to rest: turn by 135 "
            "deg about each horizontal axis of the sensor in turn, at least ten times, with 2 s of "
            "rest between, every second round backwards",
        )
    return whole


def _together(logs: list[ImuLog]) -> ImuLog:
    """Logs one after another: from one to the next the bias is what it is at another power-up."""
    before = np.cumsum([0, *(log.turns.rests for log in logs)])
    span = np.concatenate([log.course.span for log in logs])
    apart = np.cumsum(np.r_[0.0, span[:-1]])
    warm = [log.course.warm for log in logs if log.course.warm is not None]
    turns = [
        replace(turn, rest=turn.rest + int(n), t=turn.t + s)
        for log, n, s in zip(logs, before, apart, strict=False)
        for turn in log.turns.turns
    ]
    session = np.repeat(np.arange(len(logs)), [log.turns.rests for log in logs])
    parts = {
        name: np.concatenate([getattr(log.turns, name) for log in logs])
        for name in ("force", "rate", "force_sd", "rate_sd")
    }
    time = np.concatenate([log.turns.time + s for log, s in zip(logs, apart, strict=False)])
    white = float(np.sqrt(np.mean([log.turns.white**2 for log in logs])))
    whole = TurnLog(time=time, session=session, turns=tuple(turns), white=white, **parts)
    return ImuLog(
        turns=whole,
        left_out=tuple(w for log in logs for w in log.left_out),
        course=LogCourse(
            apart,
            span,
            time,
            np.concatenate(warm) if len(warm) == len(logs) else None,
            logs[0].course.gravity,
        ),
    )


def _of_one(recording: Recording, segments: Segments, gravity: float) -> ImuLog:
    triad = segments.triads[0]
    gyro = gyroscope_of(recording, triad)
    force = recording.channels[f"{triad}/acceleration"]
    _demand_together(recording, gyro, force)
    t, rate = gyro.t, gyro.values
    reading = at_times(t, force) / gravity
    step = 1.0 / gyro.rate
    moving = np.ones(len(t))
    ends = np.searchsorted(t, segments.start), np.searchsorted(t, segments.stop, side="right")
    middle = np.zeros(segments.n, np.intp)
    mean, biases, bias_sd = (np.zeros((segments.n, 3)) for _ in range(3))
    noise = np.maximum(segments.rate_noise[0], segments.rate_step[0] / np.sqrt(12.0))
    rounded = rounding_sd(segments.rate_noise[0], segments.rate_step[0])
    own = float(np.sqrt(np.mean(segments.noise[0] ** 2))) / gravity
    for k, (a, b) in enumerate(zip(*ends, strict=True)):
        bias, sd = _steady(rate[a:b], round(_PART / step))
        moving[a:b] = moving_share(rate[a:b] - bias, noise, step)
        middle[k] = (a + b) // 2
        turned = attitudes(t[a:b], moving[a:b, None] * (rate[a:b] - bias))
        turned = turned[middle[k] - a].T @ turned
        mean[k] = np.einsum("nij,nj->ni", turned, reading[a:b]).mean(axis=0)
        biases[k] = bias
        bias_sd[k] = np.hypot(np.maximum(sd, noise / np.sqrt(b - a)), rounded)
    turns, why = [], list[str]()
    flat = _flat_tops(rate)
    for k in range(segments.n - 1):
        rows = slice(int(middle[k]), int(middle[k + 1]) + 1)
        span = _drop_still_ends(moving[rows])
        rows = slice(rows.start + span[0], rows.start + span[1])
        turn = Turn(k, t[rows], rate[rows], reading[rows], moving[rows])
        reason = _unusable(turn, recording, flat[rows], step)
        if reason:
            why.append(f"turn {k + 1} ({turn.t[0]:.1f}-{turn.t[-1]:.1f} s): {reason}")
        else:
            turns.append(turn)
    warm = segments.temperature[:, 0]
    log = TurnLog(
        time=t[middle],
        force=mean,
        rate=biases,
        force_sd=own / np.sqrt(np.maximum(segments.samples[:, 0], 1)),
        rate_sd=bias_sd,
        session=np.zeros(segments.n, np.intp),
        turns=tuple(turns),
        white=float(np.sqrt(np.mean(noise**2) * step)),
    )
    known = warm if np.isfinite(warm).all() else None
    lasting = np.array([t[-1] - t[0]])
    course = LogCourse(np.zeros(1), lasting, t[middle], known, gravity)
    return ImuLog(log, tuple(why), course)


def _demand_together(recording: Recording, gyro: Channel, force: Channel) -> None:
    """Raise UnreadableInput where the two sensors were not recorded at the same time."""
    both = min(gyro.t[-1], force.t[-1]) - max(gyro.t[0], force.t[0])
    if both < 0.5 * (force.t[-1] - force.t[0]):
        raise UnreadableInput(
            f"the gyroscope's clock ({gyro.t[0]:.1f}-{gyro.t[-1]:.1f} s) and the accelerometer's "
            f"({force.t[0]:.1f}-{force.t[-1]:.1f} s) do not go together",
            where=recording.path,
            remedy="give both one clock: stamp them in one program, or take off the difference",
        )


def _steady(rate: Array, per: int) -> tuple[Array, Array]:
    """(3,) location of the rates of a rest by Huber's weights over its parts, which its ends do not
    move, and its standard deviation, as the parts scatter and follow each other."""
    count = max(len(rate) // max(per, 1), 4)
    edges = np.linspace(0, len(rate), count + 1).astype(int)
    parts = np.add.reduceat(rate, edges[:-1], axis=0) / np.diff(edges)[:, None]
    location = np.median(parts, axis=0)
    spread = 1.4826 * np.median(np.abs(parts - location), axis=0) + 1e-12
    weight = np.ones_like(parts)
    for _ in range(10):
        weight = 1.0 / np.maximum(1.0, np.abs(parts - location) / (1.5 * spread))
        location = (weight * parts).sum(axis=0) / weight.sum(axis=0)
    away = np.sqrt(weight / weight.sum(axis=0)) * (parts - location)
    square = np.sum(away**2, axis=0)
    # A hand's creep goes on in neighbouring parts: lags count until one is none (Geyer 1992).
    lags = range(1, count // 3 + 1)
    shared = np.array([np.sum(away[lag:] * away[:-lag], axis=0) for lag in lags])
    square += 2.0 * np.sum(np.where(np.cumprod(shared > 0.0, axis=0), shared, 0.0), axis=0)
    return location, np.asarray(np.sqrt(square / (count - 1)))


def moving_share(away: Array, noise: Array, step: float) -> Array:
    """(n,) by how much rates (n, 3) about a rest's mean are motion: the positive part of James' and
    Stein's factor, 1 - (p - 2) / |z|² of p means z in units of their noise, each second anew.

    noise : (3,) rad/s of a sample; step : s between samples
    """
    n = len(away)
    count = max(int(n * step / _PART), 1)
    edges = np.linspace(0, n, min(count, n) + 1).astype(int)
    size = np.diff(edges)
    means = np.add.reduceat(away, edges[:-1], axis=0) / size[:, None]
    square = np.sum(means**2 * size[:, None] / np.maximum(noise, 1e-12) ** 2, axis=1)
    sections = max(int(len(size) * _PART / _SECTION), 1)
    cuts = np.linspace(0, len(size), sections + 1).astype(int)
    out = np.zeros(n)
    for a, b in pairwise(cuts):
        whole = max(float(square[a:b].sum()), 1e-12)
        out[edges[a] : edges[b]] = max(0.0, 1.0 - (3.0 * (b - a) - 2.0) / whole)
    return out


def _drop_still_ends(moving: Array) -> tuple[int, int]:
    """Where motion begins and ends: nothing is integrated outside."""
    at = np.flatnonzero(moving > 0.0)
    return (max(int(at[0]) - 1, 0), min(int(at[-1]) + 2, len(moving))) if at.size else (0, 2)


def _flat_tops(rate: Array) -> Flags:
    """(n,) where an axis is at its largest or smallest reading, if that is a range's end: it stays
    there for longer than a smooth top that is read in steps. A parabola is within its highest step
    for at most 1 / (sqrt 2 - 1) of the time that it is in the next; by chance two samples more."""
    found = np.zeros(len(rate), bool)
    for axis in (*rate.T, *-rate.T):
        readings, count = np.unique(axis, return_counts=True)
        if len(readings) > 1 and count[-1] - 2 > count[-2] / (np.sqrt(2.0) - 1.0):
            found |= axis == readings[-1]
    return found


def _unusable(turn: Turn, recording: Recording, flat: Flags, step: float) -> str:
    """Why a turn cannot be used, or nothing."""
    t = turn.t
    gaps = [g for g in recording.gaps if g.start < t[-1] and g.stop > t[0]]
    if gaps:
        return f"a gap of {1e3 * (gaps[0].stop - gaps[0].start):.0f} ms ({gaps[0].reason})"
    if len(t) < 6 or float(np.diff(t).max()) > 2.5 * step or float(np.diff(t).min()) <= 0.0:
        return "samples are missing"
    if any(
        h.channel.endswith("angular_rate") and h.start < t[-1] and h.stop > t[0]
        for h in recording.held
    ):
        return "the gyroscope repeats one reading"
    if flat.any():
        return f"the gyroscope is clipped at {np.abs(turn.rate).max() / DEG:.0f} deg/s"
    if turn.lasting > _LONGEST:
        return f"it lasts {turn.lasting:.0f} s, in which the bias may go anywhere"
    return ""
