"""The fewest new observations that end an ambiguity: added one by one, then exchanged.

Each candidate is a (P, P) product of all columns. Beside the plan stand two others of as many: one
that determines the base model's parameters best (largest determinant), and random ones.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.separation.angle import Pair, apart

#: Rounds of exchanges, each of every place, at most.
_ROUNDS = 3


@dataclass(frozen=True)
class Pool:
    """What could be recorded. gram : (c, P, P) of each candidate; numbers : data that it gives"""

    gram: Array
    numbers: float


Worth = Callable[[Array], Array]


def separating(old: Array, pairs: tuple[Pair, ...]) -> Worth:
    """Worth (c,) of products (c, P, P) added to those there are: the least λ sin(angle), and a
    little of the others, so that a plan grows where one pair alone cannot."""

    def worth(gram: Array) -> Array:
        each = apart(old + gram, pairs)
        return np.asarray(each.min(axis=-1) + 0.05 * each.mean(axis=-1))

    return worth


def informative(old: Array, size: int) -> Worth:
    """log det of the first `size` columns' products: the base model's parameters."""

    def worth(gram: Array) -> Array:
        inside = (old + gram)[..., :size, :size] + 1e-4 * np.eye(size)
        return np.asarray(np.linalg.slogdet(inside)[1])

    return worth


def grown(pool: Pool, plan: tuple[int, ...], worth: Worth) -> tuple[int, ...]:
    """A plan with one candidate more, then each exchanged while that helps."""
    chosen = [*plan, int(np.argmax(worth(total_of(pool, plan) + pool.gram)))]
    return exchanged(pool, tuple(chosen), worth)


def one_by_one(pool: Pool, worth: Worth, count: int) -> tuple[int, ...]:
    """The best candidate beside those that are chosen, so many times, none exchanged."""
    steps, total = list[int](), np.zeros(pool.gram.shape[1:])
    for _ in range(count):
        steps.append(int(np.argmax(worth(total + pool.gram))))
        total = total + pool.gram[steps[-1]]
    return tuple(steps)


def exchanged(pool: Pool, plan: tuple[int, ...], worth: Worth) -> tuple[int, ...]:
    chosen = list(plan)
    now = float(worth(total_of(pool, tuple(chosen))[None])[0])
    for _ in range(_ROUNDS):
        before = now
        for place in range(len(chosen)):
            rest = total_of(pool, (*chosen[:place], *chosen[place + 1 :]))
            each = worth(rest + pool.gram)
            best = int(np.argmax(each))
            if float(each[best]) > now * (1.0 + 1e-6) + 1e-12:
                chosen[place], now = best, float(each[best])
        if now <= before * (1.0 + 1e-3):
            break
    return tuple(chosen)


def total_of(pool: Pool, plan: tuple[int, ...]) -> Array:
    """(P, P) products of a plan."""
    return np.asarray(pool.gram[list(plan)].sum(axis=0))
