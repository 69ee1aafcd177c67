"""Which data are left out together: one design, fixed by the data's structure before any search.

Nothing that is chosen or estimated may decide the folds, a seed as little as the outcome: the same
data have the same design, whether something is found or not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Index
from imucalib.core.observations import Observations

#: Folds of single positions, and groups up to which each is left out by itself, so that no shuffle
#: decides; of stretches of time there are as many as the calibrator made.
_FOLDS, _ALONE = 10, 12
#: Share of a stretch's rows on either side of it that train nothing when it is left out.
_GAP = 0.03
#: Observations for each group from which on groups are stretches of time.
_STRETCH = 10


@dataclass(frozen=True)
class Fold:
    """rows : that are predicted; rest : that choose and fit, with neither the rows nor the gap;
    stretch : whether the rows are one stretch of time, which counts as one number"""

    rows: Index
    rest: Index
    stretch: bool = False


def folds_of(data: Observations) -> tuple[Fold, ...]:
    """The design of some observations.

    Stretches of time (groups of many observations in order) are left out one by one, with a gap on
    both sides. Single positions, or groups of a few that share a setting, are left out one by one
    where they are few, else dealt to ten folds in a fixed shuffle: dealt in turn, a fold would take
    whole rings of a bench that repeats itself. The shuffle starts from what was read, not from the
    order of the rows.
    """
    groups, group = np.unique(data.group, return_inverse=True)
    every = np.arange(data.n)
    if data.n >= _STRETCH * groups.size:
        gap = int(np.ceil(_GAP * data.n / groups.size))
        return tuple(_stretch(np.flatnonzero(group == k), every, gap) for k in range(groups.size))
    count = groups.size if groups.size <= _ALONE else _FOLDS
    dealt = np.random.default_rng(groups.size).permutation(np.arange(groups.size) % count)
    key = dealt[_rank(data, group)]
    return tuple(Fold(every[key == k], every[key != k]) for k in range(count))


def _rank(data: Observations, group: Index) -> Index:
    """(n,) the place of each row's group among all, by the groups' mean readings."""
    reading = data.reading.reshape(data.n, -1)
    mean = np.stack([np.bincount(group, weights=c) for c in reading.T]) / np.bincount(group)
    place = np.empty(mean.shape[1], dtype=np.intp)
    place[np.lexsort(mean)] = np.arange(place.size)
    return place[group]


def _stretch(rows: Index, every: Index, gap: int) -> Fold:
    near = (every >= rows[0] - gap) & (every <= rows[-1] + gap)
    return Fold(rows, every[~near], stretch=True)


def parts_of(folds: tuple[Fold, ...]) -> Index:
    """(n,) which observations stand for one number: those of a stretch together, others alone."""
    part = np.arange(sum(fold.rows.size for fold in folds))
    for fold in folds:
        if fold.stretch:
            part[fold.rows] = fold.rows[0]
    return part
