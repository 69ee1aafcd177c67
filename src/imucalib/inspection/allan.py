"""The overlapping Allan variance of what is still, from samples that come in blocks.

σ²(τ) is half of the mean squared difference of neighbouring means over τ, at every overlap (W. J.
Riley, Handbook of Frequency Stability Analysis, NIST SP 1065, 2008, section 5.2.2). From 64 samples
on, the overlap goes in steps of 1/64 of τ, so that memory does not grow with the recording.
Stretches that do not touch add their squares.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array

_STEPS = 64  # places of a mean within τ, at most
_OCTAVES = 40  # levels at most
_FEWEST = 2.0  # degrees of freedom below which a value says nothing


@dataclass(frozen=True)
class AllanCurve:
    """tau : (M,) s, doubling; variance : (M,) of one axis, in the unit squared; freedom : (M,)
    degrees of freedom of each, the fewest of any noise; seconds : of samples in all; longest : s,
    the longest stretch"""

    tau: Array
    variance: Array
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
        self.freedom = np.zeros(len(lengths))
        self._axes = axes
        self.count = 0
        self._tail = self._odd = np.empty((0, axes))

    def restart(self) -> None:
        """A stretch has ended: what comes next has no neighbours here."""
        self.freedom += [_freedom(self.count + 1, m) for m in self.lengths]
        self.count = 0
        self._tail = self._odd = np.empty((0, self._axes))

    def add(self, values: Array) -> Array:
        """Take means in; returns the means of pairs that are complete."""
        self.count += len(values)
        every = np.concatenate([self._tail, values])
        for i, m in enumerate(self.lengths):
            seen = every[max(0, len(every) - len(values) - 2 * m + 1) :]
            if len(seen) >= 2 * m:
                x = np.concatenate([np.zeros((1, self._axes)), np.cumsum(seen, axis=0)])
                second = (x[2 * m :] - 2.0 * x[m:-m] + x[: -2 * m]) / m
                self.squares[i] += np.sum(second**2, axis=0)
                self.terms[i] += len(second)
        self._tail = every[-(2 * self.lengths[-1] - 1) :]
        pairs = np.concatenate([self._odd, values])
        whole = len(pairs) // 2 * 2
        self._odd = pairs[whole:]
        return np.asarray(0.5 * (pairs[0:whole:2] + pairs[1:whole:2]))


class AllanSums:
    """Sums of one sensor's axes over stretches of samples."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        first = tuple(1 << k for k in range(_STEPS.bit_length()))
        self._levels = [_Level(axes, first)]
        self._offset: Array | None = None
        self._longest = self._samples = 0

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
        self._samples += self._levels[0].count
        self._longest = max(self._longest, self._levels[0].count)
        for level in self._levels:
            level.restart()
        self._offset = None

    def curves(self, interval: float) -> tuple[AllanCurve, ...]:
        """One an axis, for samples every `interval` s; the stretch in hand ends. A variance with
        hardly any freedom is left out."""
        self.cut()
        tau, squares, terms, freedom = [], [], [], []
        for k, level in enumerate(self._levels):
            for i, m in enumerate(level.lengths):
                if level.terms[i] and level.freedom[i] >= _FEWEST:
                    tau.append((m << k) * interval)
                    squares.append(level.squares[i])
                    terms.append(level.terms[i])
                    freedom.append(level.freedom[i])
        variance = np.array(squares).reshape(-1, self._axes) / (2.0 * np.array(terms)[:, None])
        seconds = self._samples * interval, self._longest * interval
        return tuple(
            AllanCurve(np.array(tau), variance[:, a], np.array(freedom), *seconds)
            for a in range(self._axes)
        )


def _freedom(points: int, m: int) -> float:
    """Degrees of freedom of the overlapping variance from `points` of the integral: the fewest of
    white, flicker and random walk noise (SP 1065, table 5)."""
    if points < 2 * m + 2:
        return 0.0
    n = float(points)
    white = 3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n
    white *= 4.0 * m * m / (4.0 * m * m + 5.0)
    flicker = 5.0 * n * n / (4.0 * m * (n + 3.0 * m))
    flicker = flicker if m > 1 else 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9)
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m * m) / (n - 3.0) ** 2
    return max(min(white, flicker, walk), 0.0)
