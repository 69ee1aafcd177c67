"""Another sensor from some moment on: all nine parameters jump, which no step of biases, of scales
or of angles does.

About nominal values |v| - g is linear in the nine parameters: Σ b_i u_i + g Σ s_ij u_i u_j with
u = v/|v|. Gram matrices that grow run by run give the best split without a fit for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.calibrators.actigraph.observations import hours
from imucalib.errors import Undetermined
from imucalib.rests.runs import PostureRuns
from imucalib.units import MG

_FEWEST = 20  # posture runs on either side
_SPLITS = 400  # moments that are tried at most, before the last is found among its neighbours
_CLEARER = (
    6.0  # times that it leaves less scatter than one part that steps: a drift leaves a quarter
)
#: Columns of the biases, of the scales and of the angles: where one of them alone jumps, it is the
#: same sensor.
_PARTS = ([0, 1, 2], [3, 6, 8], [4, 5, 7])
_JUMP = 5e-3  # of a scale or an angle, below which it is the same sensor


@dataclass(frozen=True)
class Exchange:
    """time : s, middle of the two runs between which it happens; bias : (3,) m/s² and scale : (6,)
    what the parameters jump by"""

    time: float
    bias: Array
    scale: Array

    @property
    def words(self) -> str:
        bias, scale = (float(np.abs(jump).max()) for jump in (self.bias, self.scale))
        return (
            f"from {hours(self.time)} on the readings are those of another sensor: its biases "
            f"differ by up to {bias / MG:.0f} mg, "
            f"its scales and angles by up to {100 * scale:.1f} %"
        )


def exchange_in(runs: PostureRuns) -> Exchange | None:
    """The moment at which the sensor is another one, or None."""
    if runs.n < 2 * _FEWEST:
        return None
    columns, off = _linear(runs.mean)
    rows = np.arange(_FEWEST, runs.n - _FEWEST + 1, dtype=np.intp)
    coarse = rows[:: max(rows.size // _SPLITS, 1)]
    near = int(coarse[np.argmin(_left(columns, off, coarse))])
    fine = rows[np.abs(rows - near) <= max(rows.size // _SPLITS, 1)]
    row = int(fine[np.argmin(_left(columns, off, fine))])
    late = np.arange(runs.n) >= row
    stepped = (np.hstack([columns, columns[:, one] * late[:, None]]) for one in _PARTS)
    whole = min(float(np.sum(_rest(one, off) ** 2)) for one in stepped)
    both = np.hstack([columns, columns * late[:, None]])
    found, rest = np.linalg.lstsq(both, off, rcond=1e-9)[0], _rest(both, off)
    jump = np.asarray(found[9:], np.float64)
    if whole < _CLEARER * float(np.sum(rest**2)) or np.abs(jump[3:]).max() < _JUMP:
        return None
    return Exchange(float(runs.time[row - 1 : row + 1].mean()), jump[:3], jump[3:])


def refuse_exchange(found: Exchange | None, path: str, *, parts: bool) -> None:
    """Raise Undetermined where one calibration was asked for and there are two sensors."""
    if found is None or parts:
        return
    raise Undetermined(
        found.words,
        where=path,
        remedy=f"each sensor needs its own calibration: --every {found.time / 3600.0:.2f}h "
        "calibrates the parts before and after by themselves",
    )


def _linear(mean: Array) -> tuple[Array, Array]:
    """(n, 9) columns of bias (m/s²) and of scale and angles (1), and (n,) |v| - median, m/s²."""
    size = np.linalg.norm(mean, axis=1)
    g = float(np.median(size))
    u = mean / size[:, None]
    squares = g * np.stack([u[:, i] * u[:, j] for i in range(3) for j in range(i, 3)], axis=1)
    return np.hstack([u, squares]), size - g


def _left(columns: Array, off: Array, rows: Index) -> Array:
    """Sum of squares that two sets of parameters leave, split before each of the rows."""
    whole = np.hstack([columns, off[:, None]])
    edges = np.concatenate([[0], rows, [len(off)]])
    part = [whole[a:b].T @ whole[a:b] for a, b in pairwise(edges)]
    before = np.cumsum(part, axis=0)
    first, second = before[:-1], before[-1] - before[:-1]
    return np.asarray(sum(_of(gram) for gram in (first, second)))


def _of(gram: Array) -> Array:
    """(m,) what least squares leaves, of (m, 10, 10) Gram matrices, the data last."""
    inner = gram[:, :9, :9]
    inner = inner + 1e-9 * np.trace(inner, axis1=1, axis2=2)[:, None, None] * np.eye(9)
    along = gram[:, :9, 9]
    return np.asarray(
        gram[:, 9, 9] - np.sum(along * np.linalg.solve(inner, along[..., None])[..., 0], 1)
    )


def _rest(columns: Array, off: Array) -> Array:
    return np.asarray(off - columns @ np.linalg.lstsq(columns, off, rcond=1e-9)[0])
