"""Stretches of neighbouring runs: those that a search tries first, and the likeliest near one."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from imucalib.arrays import Array, Index


def tried(n: int, lengths: Iterable[int], starts: int) -> tuple[Index, Index]:
    """Starts and stops (exclusive) of stretches of n runs, `starts` of them in every length."""
    first, last = list[Index](), list[Index]()
    for length in lengths:
        at = np.arange(0, n - length + 1, max(length // starts, 1), dtype=np.intp)
        first.append(at)
        last.append(at + length)
    return np.concatenate(first), np.concatenate(last)


def with_ends(
    nats: Callable[[Index, Index], Array], n: int, first: int, last: int, fewest: int
) -> tuple[int, int]:
    """The likeliest ends, to the run, near those of a stretch of at least `fewest` of n runs.

    nats : of the rows start to stop (exclusive), (k,) each
    """
    for _ in range(2):
        reach = max((last - first) // 2, 2)
        near = np.arange(
            max(first - reach, 0), min(first + reach, last - fewest) + 1, dtype=np.intp
        )
        first = int(near[np.argmax(nats(near, np.full_like(near, last)))])
        near = np.arange(max(last - reach, first + fewest), min(last + reach, n) + 1)
        last = int(near[np.argmax(nats(np.full_like(near, first), near))])
    return first, last
