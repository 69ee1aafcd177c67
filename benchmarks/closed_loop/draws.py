"""Which worlds a run holds: the rows of the table in fixed shares, and what is planted in each."""

from __future__ import annotations

from dataclasses import replace

import bench
import numpy as np
import worn
from judge import made
from slips import KINDS as SLIPS
from world import NoSuchWorld, Recipe, World

KINDS = ("bench", "norm", "worn")
#: Strengths by row of the table; of two effects each.
STRENGTH = {
    "4-7": (4.0, 7.0),
    "8-12": (8.0, 12.0),
    "15-40": (15.0, 40.0),
    "two": (8.0, 25.0),
    "outside": (8.0, 40.0),
}
ROWS = ("clean", *STRENGTH, "slip")
#: In this order, so that any count holds all rows in about their shares.
_TURN = (
    "clean",
    "8-12",
    "15-40",
    "outside",
    "4-7",
    "two",
    "clean",
    "slip",
    "15-40",
    "4-7",
    "8-12",
    "clean",
    "outside",
    "4-7",
    "15-40",
    "slip",
    "8-12",
    "two",
    "clean",
    "outside",
)
_TRIES = 60


def rows(kind: str, count: int) -> list[str]:
    """The table's row of every world; only benches have slips, others are clean instead."""
    every = [_TURN[k % len(_TURN)] for k in range(count)]
    return every if kind == "bench" else ["clean" if r == "slip" else r for r in every]


def drawn(kind: str, row: str, seed: int) -> World:
    """The world of a seed: names and strengths are drawn until one is credible."""
    rng = np.random.default_rng((seed, 2))
    plain = Recipe(kind, row, seed, outside=row == "outside")
    if row == "clean":
        return made(plain)
    if row == "slip":
        return made(replace(plain, slip=str(rng.choice(SLIPS))))
    of = worn if kind == "worn" else bench
    names = of.outside(kind) if row == "outside" else of.effects(kind)
    for _ in range(_TRIES):
        some = rng.choice(names, 2 if row == "two" else 1, replace=False)
        planted = {str(n): float(rng.uniform(*STRENGTH[row])) for n in some}
        try:
            return made(replace(plain, planted=planted))
        except NoSuchWorld:
            continue
    raise NoSuchWorld(f"{kind} {row} {seed}")
