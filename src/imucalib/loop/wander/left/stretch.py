"""Stretches of the recording in which the bias, or the whole calibration, is another one.

What lasts for an hour of a day is not worth a parameter to a fit: its runs are strange, count less,
and the search goes on without them; or the noise becomes a bias that wanders. Here every stretch is
tried, from four runs to a quarter of the recording, by sums over runs: with columns x of the part
and the residual r beside all that was taken, in units of a run's scatter,

    L = -1/2 log|I + s² X'X| + ν/2 log(Q / (Q - b'(X'X + 1/s²)⁻¹b)),  b = X'r, Q = r'r,

over the rows of the stretch. The likeliest is then weighed as any other way, see `strongest`, the
number of stretches counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.loop.wander.choice import Search
from imucalib.loop.wander.left.spans import tried, with_ends
from imucalib.loop.wander.left.strongest import Way
from imucalib.loop.wander.left.swing import even_parts
from imucalib.loop.wander.problem import Problem
from imucalib.loop.wander.walk import beside

#: Runs of the shortest stretch and share of the longest; ratio of one length to the next; starts in
#: a length; sizes in units of the scatter.
_FEWEST, _LONGEST, _RATIO, _STARTS, _SIZES = 4, 0.25, 1.5, 4, (1.0, 10.0)
#: Runs in all below which a stretch is a large part of them.
_RUNS = 40


@dataclass(frozen=True)
class _Sums:
    """Running sums over the rows, a row of nothing first: gram (n + 1, c, c), along (n + 1, c);
    power : of all the residual"""

    gram: Array
    along: Array
    power: float

    def nats(self, start: Index, stop: Index) -> Array:
        """(k,) of the rows start to stop (exclusive), (k,) each."""
        gram = self.gram[stop] - self.gram[start]
        along = self.along[stop] - self.along[start]
        freedom, best = len(self.along) - 1, np.full(start.size, -np.inf)
        eye = np.eye(along.shape[1])
        for size in _SIZES:
            precise = gram + eye / size**2
            gain = np.sum(along * np.linalg.solve(precise, along[..., None])[..., 0], axis=1)
            volume = np.linalg.slogdet(eye + size**2 * gram)[1]
            left = np.maximum(1.0 - gain / self.power, 1e-12)
            best = np.maximum(best, -0.5 * (volume + freedom * np.log(left)))
        return best


def stretches(problem: Problem, found: Search) -> list[Way]:
    """The likeliest stretch of the bias, and of all that the base model has, as they stand and
    beside the walk."""
    bank, parts = found.bank, even_parts(problem, found)
    course = bank.course
    if course.time.size < _RUNS or "bias" not in parts:
        return []
    bias, every = parts["bias"], np.column_stack(list(parts.values()))
    root, rest = np.sqrt(course.variance)[:, None], rest_of(found)
    walk, ways = bank.walks[found.level.walk], list[Way]()
    for left in (rest, beside(course, walk, rest)) if walk.rho > 0.0 else (rest,):
        for columns, word in ((bias, "bias"), (every, "calibration")):
            some = _likeliest(_sums(columns / root, left / root[:, 0]))
            inside = np.zeros((course.time.size, 1))
            inside[some] = 1.0
            own = bias * inside if word == "calibration" else None
            words = _words(word, course.time[some])
            way = Way(words, "time", "stretch", columns * inside, own, among=_among(len(rest)))
            ways.append(way)
    return ways


def rest_of(found: Search) -> Array:
    """(n,) of the data beside all that was taken, without a walk."""
    bank, terms = found.bank, found.terms
    base, data = bank.columns[:, terms.columns], bank.columns[:, bank.data]
    weighed = base / bank.course.variance[:, None]
    precise = base.T @ weighed + np.diag(terms.precision)
    return np.asarray(data - base @ np.linalg.solve(precise, weighed.T @ data), np.float64)


def _sums(columns: Array, rest: Array) -> _Sums:
    n, c = columns.shape
    gram, along = np.zeros((n + 1, c, c)), np.zeros((n + 1, c))
    gram[1:] = np.cumsum(columns[:, :, None] * columns[:, None], axis=0)
    along[1:] = np.cumsum(columns * rest[:, None], axis=0)
    return _Sums(gram, along, float(rest @ rest))


def _likeliest(sums: _Sums) -> slice:
    """The likeliest stretch, its ends then found to the run."""
    n = len(sums.along) - 1
    start, stop = tried(n, _lengths(n), _STARTS)
    best = int(np.argmax(sums.nats(start, stop)))
    return slice(*with_ends(sums.nats, n, int(start[best]), int(stop[best]), _FEWEST))


def _lengths(n: int) -> list[int]:
    most = int(_LONGEST * n)
    count = 1 + int(np.log(most / _FEWEST) / np.log(_RATIO))
    return sorted({round(_FEWEST * _RATIO**k) for k in range(count)})


def _among(n: int) -> int:
    """Stretches between any two of n runs that the search could have found."""
    return int(n * _LONGEST * n)


def _words(word: str, time: Array) -> str:
    long = np.ptp(time) / 3600.0
    return f"the {word} is another one for {long:.2g} h, {time[0] / 3600.0:.3g} h after the start"
