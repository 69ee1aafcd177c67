"""Readings in the wrong place: two rows exchanged, one moved, a block shifted.

Every such change D of the readings is exact: RSS' = RSS + 2 D'g + D'P D at each point of noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.loop.faults.base import Base, prior_of
from imucalib.loop.faults.found import Fault, Hypothesis
from imucalib.loop.posterior.odds import OPEN

#: Hypotheses about blocks that are looked at on the whole grid, after a few of its points.
_SHORT_LIST = 60
#: Rows up to which a block may end anywhere; beyond, it reaches to an end of the sheet.
_ANY_BLOCK = 64
#: Width (mg) of the Cauchy density with which the reading that a shift leaves over repeats its
#: neighbour, or a stray one its prediction: a reading of another position costs 20 nats.
_SPARE = 3.0


def exchanges(base: Base) -> list[Hypothesis]:
    """The readings of two rows exchanged: D is d = y_q - y_p in row p, -d in row q."""
    sheet, n = base.sheet, base.sheet.n
    p, q = np.triu_indices(n, 1)
    d = sheet.reading[q] - sheet.reading[p]
    P, g = by_rows(base)
    both = P[:, p, p] + P[:, q, q] - P[:, p, q] - P[:, q, p]
    rss = base.rss[:, None] + 2.0 * np.einsum("hi,Ghi->Gh", d, g[:, p] - g[:, q])
    rss += np.einsum("hi,Ghij,hj->Gh", d, both, d)
    score = base.gain(rss, len(p))
    found = []
    for k in leading(score):
        order = np.arange(n)
        order[[p[k], q[k]]] = order[[q[k], p[k]]]
        rows = (int(sheet.row[p[k]]), int(sheet.row[q[k]]))
        what = f"rows {rows[0]} and {rows[1]}: their readings are exchanged"
        fault = Fault("exchange", what, rows, float(score[k]), f"--swap {rows[0]},{rows[1]}")
        found.append(Hypothesis(fault, sheet.with_reading(sheet.reading[order]), prior_of(len(p))))
    return found


def _stray(away: Array) -> Array:
    """Nats that a reading (..., 3) mg away from where it should be costs, multivariate Cauchy."""
    return np.asarray(2.0 * np.log1p(np.sum(away**2, axis=-1) / (2.0 * _SPARE**2)))


@dataclass(frozen=True)
class _Blocks:
    """Changes of the order: source (H, n) of each row's reading, the row that is left without
    one (H,) or -1, the reading that is left over (H,) or -1, first and last row, and direction."""

    source: Index
    lost: Index
    spare: Index
    first: Index
    last: Index
    late: NDArray[np.bool_]


def blocks(base: Base) -> list[Hypothesis]:
    """One row's reading moved to another place, or a block of readings one row late or early.

    A shift leaves one row without a reading (integrated out) and one reading over, which repeats
    its neighbour's unless it stands at an end of the sheet.
    """
    sheet = base.sheet
    tried = _orders(sheet.n, sheet.beside()) if sheet.ordered else None
    if tried is None:
        return []
    every = np.arange(len(tried.lost))
    short = np.argsort(-_scores(base.at(base.few), tried, every))[:_SHORT_LIST]
    score = _scores(base, tried, short)
    return [_block(base, tried, int(short[k]), float(score[k])) for k in leading(score)]


def _scores(base: Base, tried: _Blocks, which: Index) -> Array:
    """(h,) nats of some changes of the order beyond the sheet as it stands."""
    reading, n = base.sheet.reading, base.sheet.n
    change = (reading[tried.source[which]] - reading).reshape(len(which), -1)
    lost = tried.lost[which]
    at = np.flatnonzero(lost >= 0)
    rows = 3 * lost[at, None] + np.arange(3)
    rss = np.empty((len(base.rss), len(which)))
    for k, (P, g) in enumerate(zip(base.P, base.g, strict=True)):
        h = change @ P
        rss[k] = base.rss[k] + 2.0 * change @ g + np.einsum("hi,hi->h", h, change)
        own = P.reshape(n, 3, n, 3)[lost[at], :, lost[at]]
        part = h[at[:, None], rows] + g[rows]
        rss[k, at] -= np.einsum("hi,hi->h", part, np.linalg.solve(own, part[..., None])[..., 0])
    rss[:, at] *= base.dof / max(base.dof - 3.0, 1.0)
    twin = np.where(tried.late[which], tried.first[which], tried.last[which])
    away = reading[tried.spare[which]] - reading[tried.source[which, twin]]
    return base.gain(rss, len(tried.lost)) - np.where(lost >= 0, _stray(away), 0.0)


def _orders(n: int, beside: Index) -> _Blocks | None:
    """Every block of three or more neighbouring rows, moved in both directions and shifted."""
    gap = np.concatenate([[0], np.cumsum(1 - beside)])
    ends = [
        (a, b)
        for a in range(n)
        for b in range(a + 2, n)
        if gap[a] == gap[b] and (n <= _ANY_BLOCK or a == 0 or b == n - 1)
    ]
    found = []
    for a, b in ends:
        for late in (True, False):
            source = np.arange(n)
            if late:  # the readings of a+1..b are those of a..b-1
                source[a:b] = np.arange(a + 1, b + 1)
            else:
                source[a + 1 : b + 1] = np.arange(a, b)
            turned = source.copy()
            turned[b if late else a] = a if late else b
            found.append((turned, -1, 0, a, b, late))
            found.append((source, b if late else a, a if late else b, a, b, late))
    if not found:
        return None
    columns = [np.array(column) for column in zip(*found, strict=True)]
    return _Blocks(*columns)


def _block(base: Base, tried: _Blocks, k: int, score: float) -> Hypothesis:
    sheet, prior = base.sheet, prior_of(len(tried.lost))
    a, b = int(sheet.row[tried.first[k]]), int(sheet.row[tried.last[k]])
    rows = tuple(range(a, b + 1))
    reading = sheet.reading[tried.source[k]]
    late = bool(tried.late[k])
    if tried.lost[k] < 0:
        at, to = (a, b) if late else (b, a)
        what = f"row {at}: its reading belongs to row {to}, and those between one row nearer"
        fault = Fault("move", what, rows, score, f"--move {at},{to}")
        return Hypothesis(fault, sheet.with_reading(reading), prior)
    step, lost = (-1, b) if late else (1, a)
    what = (
        f"rows {a} to {b}: their readings stand one row {'late' if late else 'early'}, "
        f"row {lost} has none"
    )
    fault = Fault("shift", what, rows, score, f"--shift readings:{a}-{b}={step}")
    left = np.setdiff1d(np.arange(sheet.n), tried.lost[k])
    return Hypothesis(fault, sheet.with_reading(reading).take(left), prior)


def by_rows(base: Base) -> tuple[Array, Array]:
    """P as (G, n, n, 3, 3) and g as (G, n, 3)."""
    n = base.sheet.n
    P = base.P.reshape(-1, n, 3, n, 3).transpose(0, 1, 3, 2, 4)
    return P, base.g.reshape(-1, n, 3)


def leading(score: Array) -> Index:
    """Those that are worth being solved again, best first."""
    best = float(score.max(initial=-np.inf))
    if best <= -OPEN / 3.0:
        return np.zeros(0, np.intp)
    order = np.argsort(-score)[:8]
    return order[score[order] > max(-OPEN / 3.0, best - OPEN)]
