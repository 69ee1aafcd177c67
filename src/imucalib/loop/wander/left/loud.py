"""Whether runs scatter by another size for a while: a night beside a day, a drawer, a loose strap.

Of every run the log density of Student's t with four degrees of freedom is known at sixty sizes.
Running sums of these give any stretch the likeliest size of its own, and all other runs theirs:

    gain = max_s W(s) + max_s [T(s) - W(s)] - max_s T(s)

with T(s) the sum over all runs and W(s) that over the stretch.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.found import Unexplained
from imucalib.loop.thresholds import AXIS_NATS
from imucalib.loop.wander.left.spans import tried, with_ends

TAILS = 4.0
#: Sizes about the first guess that are tried.
SCALES = np.geomspace(0.1, 3.0, 60)
_WIDE = np.geomspace(0.05, 30.0, 60)
#: Runs of the shortest stretch, ratio of one length to the next, starts in a length.
_FEWEST, _RATIO, _STARTS = 6, 1.4, 6
#: Times the scatter of the others from which on it is no night beside a day.
_LOUD = 3.0


@dataclass(frozen=True)
class Stretch:
    """rows : the stretch; times : its scatter over that of the other runs; nats : that it
    gains, less the log of how many were tried; factor : (n,) variance of each run over that of the
    others"""

    rows: slice
    times: float
    nats: float
    factor: Array


def stretch_of(left: Array, variance: Array) -> Stretch | None:
    """The likeliest stretch of residuals (n,) with these variances; None in too few runs."""
    n = left.size
    if n < 4 * _FEWEST:
        return None
    each = left[:, None] ** 2 / variance[:, None] / (TAILS * _WIDE**2)
    every = -0.5 * (TAILS + 1.0) * np.log1p(each) - np.log(_WIDE)
    sums = np.vstack([np.zeros(_WIDE.size), np.cumsum(every, axis=0)])
    nats_of = partial(_nats, sums)
    start, stop = tried(n, _lengths(n), _STARTS)
    best = int(np.argmax(nats_of(start, stop)))
    first, last = with_ends(nats_of, n, int(start[best]), int(stop[best]), _FEWEST)
    rows, own = slice(first, last), sums[last] - sums[first]
    times = float(_WIDE[np.argmax(own)] / _WIDE[np.argmax(sums[-1] - own)])
    factor = np.ones(n)
    factor[rows] = times**2
    nats = float(nats_of(np.array([first]), np.array([last]))[0])
    gain = nats - float(sums[-1].max() + np.log(start.size))
    return Stretch(rows, times, gain, factor)


def _nats(sums: Array, start: Index, stop: Index) -> Array:
    """(k,) of the rows start to stop (exclusive) with a size of their own."""
    inside = sums[stop] - sums[start]
    return np.asarray(inside.max(axis=1) + (sums[-1] - inside).max(axis=1))


def _lengths(n: int) -> Iterator[int]:
    length = float(_FEWEST)
    while length <= n - _FEWEST:
        yield int(length)
        length *= _RATIO


def in_words(found: Stretch, time: Array) -> tuple[Unexplained, ...]:
    """The stretch in words, where odds of e^10 speak for it and its runs scatter three times as
    much. time : (n,) s"""
    if found.nats <= AXIS_NATS or found.times < _LOUD:
        return ()
    at = time[found.rows]
    times = float(f"{found.times:.1g}")
    words = (
        f"noise of a run, some {times:.0f} times that of the others for "
        f"{np.ptp(at) / 3600.0:.2g} h, {at[0] / 3600.0:.3g} h after the start"
    )
    p = float(np.exp(-found.nats))
    return (Unexplained(words, "time", "stretch", p, found.nats, 0.0),)
