"""Looks that are paid for beforehand: at fixed numbers of rows, each at a level of its own.

A martingale reaches 20 at one look far more rarely than in one of twenty tables: most of its chance
lies in rows to come. So most of the stake is spent on looks at numbers of rows that stand before
the data do: a look spends the chance w_j α of being the first to be passed by tables that lack
nothing (Lan and DeMets 1983, Biometrika 70, 659-663; the w_j sum to one). What is asked is the
ratio of likelihoods itself, against simulated tables, of which the first rows are the same at every
look. A table that grows keeps its looks: the rows that it had then are its first ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array
from imucalib.loop.anytime.ratio import Rows, log_mean, log_ratios

#: Rows at the first look, and by what they grow from one to the next.
FIRST, STEP = 16, 1.12
#: Share of the chance for the first looks, alike, and how many these are: sheets of 16 to 70 rows
#: are what benches have. The rest is for all that come later.
SOON, LOOKS_SOON = 0.8, 14
#: Simulated tables: of the least chance of an early look, ten.
_DRAWS = 4000


@dataclass(frozen=True)
class Table:
    """rows : numbers, as many a row as there are; n : rows of the table; data : (N,); ratio : of
    the settings' scatter to the noise; points : ratios that likelihoods are a mean over"""

    rows: Rows
    n: int
    data: Array
    ratio: tuple[float, ...]
    points: Sequence[tuple[float, ...]]


def schedule(rows: int) -> tuple[tuple[int, float], ...]:
    """Rows of each look at a table of so many, and its share of the chance; all shares that could
    ever be sum to one."""
    looks, k = list[tuple[int, float]](), 0
    while (at := round(FIRST * STEP**k)) <= rows:
        late = (1.0 - SOON) * LOOKS_SOON / max(k * (k + 1), 1)  # 1 / (k (k + 1)) sums to 1 / first
        looks.append((at, SOON / LOOKS_SOON if k < LOOKS_SOON else late))
        k += 1
    return tuple(looks)


def passed(table: Table, chance: float, seed: int = 0) -> bool:
    """Whether any look is passed. chance : of a table that lacks nothing, over all looks.

    A ratio of likelihoods has mean one by chance: below one it passes no look, and beyond one over
    a look's chance it passes without a simulation (Markov).
    """
    each = table.data.size // table.n
    fitted = table.rows.jacobian.shape[1]
    looks = [(m * each, w) for m, w in schedule(table.n) if m * each > fitted + 1]
    found = [float(_evidence(table, table.data[:, None], m)[0]) for m, _ in looks]
    if any(e >= -np.log(chance * w) for e, (_, w) in zip(found, looks, strict=True)):
        return True
    while found and found[-1] <= 0.0:
        found.pop()
    return bool(found) and _beyond(table, looks[: len(found)], found, chance, seed)


def _beyond(
    table: Table, looks: Sequence[tuple[int, float]], found: Sequence[float], chance: float,
    seed: int,
) -> bool:  # fmt: skip
    null, spent = _drawn(table, seed), 0.0
    gone = np.zeros(_DRAWS, bool)
    for (numbers, share), own in zip(looks, found, strict=True):
        spent += share
        left = np.where(gone, -np.inf, _evidence(table, null, numbers))
        number = round(chance * spent * _DRAWS) - int(gone.sum())
        bar = float(np.sort(left)[-number]) if number > 0 else np.inf
        if own > bar:
            return True
        gone |= left >= bar
    return False


def _evidence(table: Table, data: Array, numbers: int) -> Array:
    """(D,) log of the mean ratio over effects, of the first numbers of data (N, D)."""
    return log_mean(log_ratios(table.rows.first(numbers), data[:numbers], table.points))


def _drawn(table: Table, seed: int) -> Array:
    """(N, draws) tables that lack nothing; one that has grown begins with the same rows."""
    n = table.data.size
    data: Array = np.random.default_rng([seed, 0]).standard_normal((n, _DRAWS))
    for c, (matrix, sd) in enumerate(zip(table.rows.settings, table.ratio, strict=True), start=1):
        if sd > 0.0:
            rng = np.random.default_rng([seed, c])
            data += sd * matrix @ rng.standard_normal((matrix.shape[1], _DRAWS))
    return data
