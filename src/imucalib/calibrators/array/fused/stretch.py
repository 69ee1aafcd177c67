"""Readings of an array's IMUs side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index


@dataclass(frozen=True)
class Stretch:
    """Readings of K IMUs at the same instants, in the sensors' own axes; NaN where missing.

    t : (T,) s; acceleration : (T, K, 3) m/s²; rate : (T, K, 3) rad/s
    """

    t: Array
    acceleration: Array
    rate: Array

    def take(self, rows: slice | Index | Flags) -> Stretch:
        return Stretch(self.t[rows], self.acceleration[rows], self.rate[rows])


def along(axes: Array, vectors: Array) -> Array:
    """(T, K, 3) what axes (K, 3, 3), one in a row, see of vectors (T, K, 3)."""
    seen = np.matmul(vectors.transpose(1, 0, 2), axes.transpose(0, 2, 1))
    return np.asarray(seen.transpose(1, 0, 2))
