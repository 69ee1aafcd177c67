"""Overlapping Allan variances of the stretches of a recording, in one pass.

σ²(τ) is half of the mean squared difference of neighbouring means over τ, at every overlap (W. J.
Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, section 5.2.2). From 64 samples
on, the overlap goes in steps of 1/64 of τ, so that memory does not grow with the recording.
Stretches that do not touch add their squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.estimators.allan import SHAPES, covariance_forms, freedom_of

_STEPS = 64  # places of a mean within τ, at most
_OCTAVES = 40  # levels at most
_LEAST_FREEDOM = 2.0  # degrees of freedom of white noise below which a value says nothing
_AT_REST = 0.3  # s, where stretches are held against each other: what settles is slower
_LOUDER = np.geomspace(3.0, 300.0, 10)  # times the variance that a stretch may have that settles
_WHITE = np.array([name == "white" for name in SHAPES], float)
_SETTLES = 0.2  # prior probability that a stretch does


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

    def interval(self, level: float = 0.95) -> tuple[Array, Array]:
        """(M,) ends of the deviation's interval, by its chi-square (SP 1065, section 5.3.1)."""
        from scipy.special import chdtri

        ends = (1.0 + level) / 2.0, (1.0 - level) / 2.0
        low, high = (self.variance * self.freedom / chdtri(self.freedom, 1.0 - e) for e in ends)
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
