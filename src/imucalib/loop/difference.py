"""What a search has gained on data that took no part in it: a difference with its interval.

Every part of the design gives one pair of errors, before and after. Parts share most of what they
were trained on, so that their scatter understates how much the gain would vary from one recording
to the next; Nadeau and Bengio (2003) widen it by sqrt(1 + n_test / n_train) in units of the plain
standard error: sqrt(1 + K / (K - 1)) for K folds, where K counts the folds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.estimators.student import quantile

Metric = Literal["rms", "mean"]
_LEVEL = 0.95


@dataclass(frozen=True)
class Difference:
    """Held-out error before and after, in the errors' unit.

    gain : before - after; low, high : its 95 % interval, widened for the training data that the
    folds share; plain_low : the lower edge without that
    parts : numbers that the interval rests on
    nats, nats_low : what the log density of the rows that were left out has gained, and the lower
        edge of its plain interval over the folds; NaN where it was not computed
    """

    before: float
    after: float
    low: float
    high: float
    plain_low: float
    parts: int
    nats: float = float("nan")
    nats_low: float = float("nan")

    @property
    def gain(self) -> float:
        return self.before - self.after

    @property
    def proved(self) -> bool:
        """Whether the interval of the error or of the density lies above zero."""
        return self.low > 0.0 or self.nats_low > 0.0

    @property
    def likely(self) -> bool:
        """Whether the parts as they are gained, in error or in density: enough to correct, not to
        call it explained."""
        return self.plain_low > 0.0 or self.nats_low > 0.0

    @property
    def holds(self) -> bool:
        """Whether data that took no part allow the steps: error and density both gain, or the error
        falls beyond the scatter of the parts. Where rows share setting errors the plain error is
        mostly theirs, and the density excuses what a dial does by its other rows."""
        return self.plain_low > 0.0 or (self.gain > 0.0 and not self.nats <= 0.0)


def difference(
    before: Array, after: Array, part: NDArray[np.intp], folds: int, metric: Metric
) -> Difference:
    """From the sizes (n,) of held-out errors, before and after on the same observations.

    part : (n,) which observations stand for one number: an observation by itself on a bench, a
        stretch of time on a wrist; metric : root mean square or mean of the sizes
    """
    power = 2.0 if metric == "rms" else 1.0
    change = before**power - after**power
    keys, index = np.unique(part, return_inverse=True)
    count = np.bincount(index).astype(float)
    total = np.bincount(index, weights=change)
    mean = float(total.sum() / count.sum())
    m = keys.size
    # The ratio estimator: parts of unequal size count by their observations.
    off = (total - mean * count) / count.mean()
    error = float(np.sqrt(np.sum(off**2) / max(m - 1, 1) / m)) if m > 1 else np.inf
    reach = quantile(max(m - 1, 1), 0.5 + _LEVEL / 2.0)
    wide = float(np.sqrt(1.0 + folds / max(folds - 1, 1)))
    start, end = (float(np.mean(e**power) ** (1.0 / power)) for e in (before, after))
    # rms_b - rms_a is (ms_b - ms_a) / (rms_b + rms_a): the interval of the squares in the unit.
    unit = start + end if metric == "rms" else 1.0
    unit = unit if unit > 0.0 else 1.0
    low, high = (mean - reach * wide * error) / unit, (mean + reach * wide * error) / unit
    return Difference(start, end, low, high, (mean - reach * error) / unit, m)


def with_density(found: Difference, nats: Array) -> Difference:
    """With the gains (K,) in log density, fold by fold."""
    k = nats.size
    error = float(np.std(nats, ddof=1) * np.sqrt(k)) if k > 1 else np.inf
    low = float(nats.sum()) - quantile(max(k - 1, 1), 0.5 + _LEVEL / 2.0) * error
    return replace(found, nats=float(nats.sum()), nats_low=low)
