"""White noise, bias instability and random walk of still sensors, as far as a recording shows them:
a posterior over all of them together, and over the rests that still settle.

It stands on overlapping Allan variances of the rests, in one pass. σ²(τ) is half of the mean
squared difference of neighbouring means over τ, at every overlap (W. J. Riley, Handbook of
Frequency Stability Analysis, NIST SP 1065, 2008, section 5.2.2). From 64 samples on, the overlap
goes in steps of 1/64 of τ, so that memory does not grow with the recording. Stretches that do not
touch add their squares.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.data import Data
from imucalib.estimators.allan import (
    SHAPES,
    covariance_forms,
    draws,
    find_unexplained,
    freedom_of,
    shapes,
)
from imucalib.recording.recording import Channel, Recording
from imucalib.rests.segments import Segments
from imucalib.rests.spans import BLUR

_STEPS = 64  # places of a mean within τ, at most
_OCTAVES = 40  # levels at most
_LEAST_FREEDOM = 2.0  # degrees of freedom of white noise below which a value says nothing
_AT_REST = 0.3  # s, where stretches are held against each other: what settles is slower
_LOUDER = np.geomspace(3.0, 300.0, 10)  # times the variance that a stretch may have that settles
_WHITE = np.array([name == "white" for name in SHAPES], float)
_SETTLES = 0.2  # prior probability that a stretch does
_FEWEST = 5  # values that a fit needs
_SHOWN = 0.1  # share of the variance at some τ that a term must be, to show
_ODD = 1.5  # intervals between samples from which on there is a gap
_SENSORS = {"acceleration": "m/s2", "angular_rate": "rad/s"}
_PREFIX = {"acceleration": "accelerometer", "angular_rate": "gyroscope"}


@dataclass(frozen=True)
class AllanCurve:
    """samples, tau : (M,) averaging times in samples and s, doubling; variance : (M,) of one axis,
    in the unit squared; forms : (5, 5, M, M) of their covariance (`covariance_forms`)
    freedom : (M,) degrees of freedom of each; seconds : of samples in all; longest : s, the longest
    stretch"""

    samples: Index
    tau: Array
    variance: Array
    forms: Array
    freedom: Array
    seconds: float
    longest: float

    @property
    def deviation(self) -> Array:
        return np.sqrt(self.variance)

    def interval(self) -> tuple[Array, Array]:
        """(M,) ends of the deviation's 95 % interval by its χ² (SP 1065, section 5.3.1)."""
        from scipy.special import chdtri

        tails = 0.025, 0.975
        low, high = (self.variance * self.freedom / chdtri(self.freedom, p) for p in tails)
        return np.sqrt(low), np.sqrt(high)


class _Level:
    """Means of 2^level samples, one after the other, and what they add to the squares."""

    def __init__(self, axes: int, lengths: tuple[int, ...]) -> None:
        self.lengths = lengths
        self.squares = np.zeros((len(lengths), axes))
        self.terms = np.zeros(len(lengths), dtype=np.int64)
        self.count = 0
        self._tail = self._odd = np.empty((0, axes))

    def cut(self) -> None:
        """A stretch has ended: what comes next has no neighbours here."""
        self.squares, self.terms = np.zeros_like(self.squares), np.zeros_like(self.terms)
        self.count, self._tail, self._odd = 0, self._tail[:0], self._odd[:0]

    def add(self, values: Array) -> Array:
        """Take means in; returns the means of pairs that are complete."""
        self.count += len(values)
        every = np.concatenate([self._tail, values])
        for i, m in enumerate(self.lengths):
            seen = every[max(0, len(every) - len(values) - 2 * m + 1) :]
            if len(seen) >= 2 * m:
                x = np.concatenate([np.zeros((1, seen.shape[1])), np.cumsum(seen, axis=0)])
                second = (x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]) / m
                self.squares[i] += np.sum(second**2, axis=0)
                self.terms[i] += len(second)
        self._tail = every[-(2 * self.lengths[-1] - 1) :]
        pairs = np.concatenate([self._odd, values])
        whole = len(pairs) // 2 * 2
        self._odd = pairs[whole:]
        return np.asarray(0.5 * (pairs[0:whole:2] + pairs[1:whole:2]))


@dataclass(frozen=True)
class _Stretch:
    """squares, terms : of every level while it lasted, (M, axes) and (M,); samples : in all"""

    squares: Array
    terms: Index
    samples: int


class AllanSums:
    """Sums of one sensor's axes over stretches of samples."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        self._levels = [_Level(axes, tuple(1 << k for k in range(_STEPS.bit_length())))]
        self._offset: Array | None = None
        self._stretches: list[_Stretch] = []

    def add(self, values: Array) -> None:
        """The next samples (n, axes) of a stretch."""
        if not len(values):
            return
        if self._offset is None:
            self._offset = values[0].copy()
        means = values - self._offset
        for k in range(_OCTAVES):
            if k == len(self._levels):
                self._levels.append(_Level(self._axes, (_STEPS,)))
            means = self._levels[k].add(means)
            if not len(means):
                break

    def cut(self) -> None:
        """The stretch ends here."""
        if self._levels[0].count:
            squares = np.concatenate([level.squares for level in self._levels])
            terms = np.concatenate([level.terms for level in self._levels])
            self._stretches.append(_Stretch(squares, terms, self._levels[0].count))
        for level in self._levels:
            level.cut()
        self._offset = None

    @property
    def _samples(self) -> Index:
        every = [m << k for k, level in enumerate(self._levels) for m in level.lengths]
        return np.array(every)

    def quiet(self, interval: float) -> Flags:
        """(S,) which stretches have the variance of the quietest, for samples every `interval` s.

        Of two kinds, those that rest and those that still settle, at an averaging time of 0.3 s:
        each variance over that of the resting ones is chi-square, times one or times a factor up to
        300; which is which, and the variance, by expectation and maximisation from the quietest
        quarter. A stretch too short to tell counts as at rest.
        """
        at = int(np.argmin(np.abs(np.log(self._samples * interval / _AT_REST))))
        kept = np.array([s.terms.size > at and s.terms[at] > 0 for s in self._stretches])
        told = [s for s, k in zip(self._stretches, kept, strict=True) if k]
        quiet = np.ones(len(kept), dtype=bool)
        if len(told) < 2:
            return quiet
        value = np.array([s.squares[at] / (2.0 * s.terms[at]) for s in told])
        lengths = np.array([s.samples for s in told])
        half = 0.5 * _white_freedom(int(self._samples[at]), lengths, interval)[:, None]
        weight = half / half.sum()
        order = np.argsort(np.log(np.maximum(value, 1e-300)).sum(axis=1))
        own = np.isin(np.arange(len(told)), order[: max(1, len(told) // 4)]).astype(float)
        prior = np.log(_SETTLES / (1.0 - _SETTLES))
        for _ in range(20):
            share = own[:, None] * weight
            rest = (share * value).sum(axis=0) / share.sum(axis=0)
            ratio = np.maximum(value / np.maximum(rest, 1e-300), 1e-12)[..., None]
            louder = half[..., None] * (ratio - ratio / _LOUDER - np.log(_LOUDER))
            odds = np.logaddexp(0.0, np.logaddexp.reduce(louder, axis=2) - np.log(_LOUDER.size))
            odds = odds.sum(axis=1) - value.shape[1] * np.log(2.0) + prior
            own = 1.0 / (1.0 + np.exp(np.clip(odds, -50.0, 50.0)))
        quiet[np.flatnonzero(kept)] = own > 0.5
        return quiet

    def curves(self, interval: float, which: Flags | None = None) -> tuple[AllanCurve, ...]:
        """One an axis, for samples every `interval` s, of some stretches or all; the stretch in
        hand ends. A variance with hardly any freedom is left out."""
        self.cut()
        used = [s for k, s in enumerate(self._stretches) if which is None or which[k]]
        size = self._samples.size
        squares, terms = np.zeros((size, self._axes)), np.zeros(size)
        for one in used:
            squares[: one.terms.size] += one.squares
            terms[: one.terms.size] += one.terms
        seen = np.flatnonzero(terms > 0)
        lengths = np.array([s.samples for s in used], dtype=int)
        forms = covariance_forms(self._samples[seen], lengths, interval)
        tau = np.asarray(self._samples[seen] * interval, float)
        freedom = freedom_of(_WHITE, tau, forms)
        good = freedom >= _LEAST_FREEDOM
        seen, tau, freedom = seen[good], tau[good], freedom[good]
        variance = squares[seen] / (2.0 * terms[seen][:, None])
        forms = forms[:, :, good][..., good]
        span = lengths.sum() * interval, lengths.max(initial=0) * interval
        return tuple(
            AllanCurve(self._samples[seen], tau, variance[:, a], forms, freedom, *span)
            for a in range(self._axes)
        )


def _white_freedom(samples: int, lengths: Index, interval: float) -> Array:
    """(S,) degrees of freedom of the variance of white noise over each stretch."""
    own = np.array([samples])
    every, which = np.unique(lengths, return_inverse=True)
    tau = own * interval
    each = [
        freedom_of(_WHITE, tau, covariance_forms(own, every[k : k + 1], interval))
        for k in range(every.size)
    ]
    return np.concatenate(each)[which]


class Coefficient(Data):
    """A term of the noise of one axis, in SI: Q in s, N in 1/√Hz, B, K in 1/s/√Hz, R in 1/s."""

    value: Annotated[float | None, "Median; null where the recording does not show it."]
    low: Annotated[float | None, "Of its 95 % interval."]
    high: float | None
    below: Annotated[float, "What it lies below, 95 %."]
    probability: Annotated[float, "That it is a tenth of the variance at some τ."]


@dataclass(frozen=True)
class AxisNoise:
    """One axis at rest, in SI.

    quantisation : Q, unit s; white : N, unit/√Hz; instability : B, unit; walk : K, unit/s/√Hz
    ramp : R, unit/s; curve : what they were found from
    fit : (3, M) deviation at the curve's τ by their sum: the median, and a 95 % interval
    holds : (M,) which of the curve's τ they explain
    """

    quantisation: Coefficient
    white: Coefficient
    instability: Coefficient
    walk: Coefficient
    ramp: Coefficient
    curve: AllanCurve
    fit: Array
    holds: Flags


@dataclass(frozen=True)
class SensorNoise:
    """The axes of one sensor: its quantity, triad, unit, samples a second, and topic; settles :
    (start, stop) s of rests that are louder than the quietest, which are not used"""

    triad: str
    quantity: str
    unit: str
    rate: float
    axes: tuple[AxisNoise, ...]
    settles: tuple[tuple[float, float], ...]
    topic: str = ""


def noise_at_rest(blocks: Iterable[Recording], still: Segments) -> tuple[SensorNoise, ...]:
    """The noise of every sensor in SI units over the still segments, in one pass over the blocks;
    sensors without enough samples at rest are left out."""
    found: dict[str, _Collected] = {}
    for block in blocks:
        for name, channel in block.channels.items():
            if _SENSORS.get(channel.quantity) == channel.unit and channel.t.size:
                found.setdefault(name, _Collected(channel)).add(channel, still)
    noise = []
    for one in found.values():
        like, quiet = one.like, one.quiet()
        curves = one.sums.curves(1.0 / like.rate, quiet)
        if len(curves[0].tau) >= _FEWEST and all((c.variance > 0.0).all() for c in curves):
            axes = tuple(map(identify, curves))
            settles = tuple(s for s, q in zip(one.spans, quiet, strict=True) if not q)
            words = (like.triad, like.quantity, like.unit, like.rate)
            noise.append(SensorNoise(*words, axes, settles, like.topic))
    return tuple(noise)


class _Collected:
    """The sums of one channel over the rests, and when each stretch was."""

    def __init__(self, channel: Channel) -> None:
        self.like = channel
        self.sums = AllanSums(channel.values.shape[1])
        self.spans: list[tuple[float, float]] = []
        self._last, self._in = -np.inf, -1

    def add(self, channel: Channel, still: Segments) -> None:
        """The samples of a block that lie in rests, without their ends."""
        t = channel.t
        at = np.searchsorted(still.start + BLUR, t, side="right") - 1
        ends = still.stop[np.maximum(at, 0)] - BLUR if still.n else np.zeros(t.size)
        inside = (at >= 0) & (t <= ends)
        rows = np.flatnonzero(inside)
        if not len(rows):
            return
        step = np.diff(t[rows], prepend=self._last)
        other = np.diff(at[rows], prepend=self._in) != 0
        breaks = np.flatnonzero(other | (step > _ODD / channel.rate) | (step <= 0.0))
        for number, part in enumerate(np.split(rows, breaks)):
            if number:
                self.sums.cut()
            if len(part):
                if number or not self.spans:
                    self.spans.append((float(t[part[0]]), 0.0))
                self.spans[-1] = self.spans[-1][0], float(t[part[-1]])
            self.sums.add(channel.values[part])
        self._last, self._in = float(t[rows[-1]]), int(at[rows[-1]])

    def quiet(self) -> Flags:
        """(S,) which stretches are at rest as the quietest are."""
        self.sums.cut()
        return self.sums.quiet(1.0 / self.like.rate)


def identify(curve: AllanCurve) -> AxisNoise:
    """The coefficients of a curve of five or more values, by the posterior of `draws`.

    One that is a tenth of the variance at some τ in 97.5 % of the draws is told with the median and
    the interval; of any other stands what it lies below under a prior flat in itself.
    """
    rng = np.random.default_rng(0)
    interval = float(curve.tau[0] / curve.samples[0])
    found = draws(curve.samples, curve.variance, curve.forms, interval, rng=rng)
    squares = np.exp(found[:, :5])
    share = squares[:, None, :] * shapes(curve.tau)
    whole = share.sum(axis=2)
    share /= whole[..., None]
    unexplained = find_unexplained(len(curve.tau), found)
    share[unexplained] = 0.0
    shown = np.mean(share.max(axis=1) > _SHOWN, axis=0)
    terms = {
        name: _coefficient(np.sqrt(squares[:, k]), float(shown[k])) for k, name in enumerate(SHAPES)
    }
    middle = np.exp(np.median(found[:, :5], axis=0))
    freedom = freedom_of(middle, curve.tau, curve.forms)
    return AxisNoise(
        **terms,
        curve=replace(curve, freedom=freedom),
        fit=np.quantile(np.sqrt(whole), [0.5, 0.025, 0.975], axis=0),
        holds=np.mean(unexplained, axis=0) < 0.5,
    )


def _coefficient(size: Array, probability: float) -> Coefficient:
    """From draws (n,) under a prior that is flat in the logarithm."""
    order = np.argsort(size)
    rank = np.cumsum(size[order]) / size.sum()
    bound = float(size[order][np.searchsorted(rank, 0.95)])
    if probability < 0.975:
        return Coefficient(None, None, None, bound, probability)
    low, value, high = (float(q) for q in np.quantile(size, [0.025, 0.5, 0.975]))
    return Coefficient(value, low, high, bound, probability)


def noisiest(axes: Sequence[AxisNoise], term: str) -> AxisNoise:
    """The axis that has most of a term: of those that show it, else by what it lies below."""

    def size(axis: AxisNoise) -> tuple[bool, float]:
        own: Coefficient = getattr(axis, term)
        return own.value is not None, own.below if own.value is None else own.value

    return max(axes, key=size)


def noise_blocks(noise: Sequence[SensorNoise]) -> dict[str, dict[str, Any]]:
    """By triad: densities in unit/√Hz and random walks in unit/s/√Hz (SI), each of the noisiest
    axis; "upper_limits" names those that the recording shows on no axis, which lie below what
    stands there with 95 %."""
    blocks: dict[str, dict[str, Any]] = {}
    for sensor in noise:
        block = blocks.setdefault(sensor.triad, {})
        for name, term in (("noise_density", "white"), ("random_walk", "walk")):
            key = f"{_PREFIX[sensor.quantity]}_{name}"
            most: Coefficient = getattr(noisiest(sensor.axes, term), term)
            block[key] = most.below if most.value is None else most.value
            if most.value is None:
                block.setdefault("upper_limits", []).append(key)
        block["rostopic"] = sensor.topic or f"/{sensor.triad}/imu"
        block["update_rate"] = sensor.rate
    return blocks
