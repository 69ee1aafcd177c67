"""Before and after on motion that took no part: what is told, chosen anew on each half of it.

One design, fixed before the search: blocks of a few seconds in two halves. On one half positions,
noise, effects and their choice among the sets that were likely are made anew, which may find none,
then the other half is predicted with all of it held;
only the motion of each sample is its own, and the phases of the gyros' clocks come from samples in
between that are never predicted. Base and final model stand on the same samples.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.motion.ages import add_clock, find_voting
from imucalib.calibrators.array.motion.covariance import transfer_to
from imucalib.calibrators.array.motion.setup import FEWEST, Setup, part_of
from imucalib.calibrators.array.motion.state import ArrayState, refit_motion
from imucalib.core.effect import Channel
from imucalib.posterior.closed_loop.found import CheckedError
from imucalib.posterior.held_out import Difference, difference
from imucalib.units import DEG

#: Standard deviation of normal errors over their median absolute deviation.
NORMAL_MAD = 1.4826
_HALVES = 2
_FOLLOWED = 3  # rounds of the motion, with its weights, under a model that does not move
_NO_ERROR = 1e-12  # m/s² or rad/s
CHANNELS: tuple[Channel, Channel] = ("acceleration", "angular_rate")


@dataclass(frozen=True)
class Residuals:
    """Median absolute deviations: acceleration (m/s²) and rate (deg/s)."""

    acceleration: float
    rate: float


@dataclass(frozen=True)
class Gained:
    """acceleration (m/s²), rate (rad/s) : median absolute deviations before and after"""

    acceleration: Difference
    rate: Difference

    @property
    def before(self) -> Residuals:
        return Residuals(self.acceleration.before, self.rate.before / DEG)

    @property
    def after(self) -> Residuals:
        return Residuals(self.acceleration.after, self.rate.after / DEG)

    @property
    def checks(self) -> tuple[CheckedError, ...]:
        """Errors before and after."""
        before, after = self.before, self.after
        return (
            CheckedError("acc residual", "m/s²", before.acceleration, after.acceleration, 3),
            CheckedError("gyro residual", "deg/s", before.rate, after.rate),
        )

    def select_deciding(self, channels: Collection[Channel]) -> Difference:
        """The error that has changed by the most, of the sensors that effects act on: held-out
        readings of k sensors, each of its own noise, are as much likelier as the sum of the
        logarithms of what their errors fall by; of two the larger one has the sign of it."""
        own = [
            d
            for c, d in zip(CHANNELS, (self.acceleration, self.rate), strict=True)
            if c in channels
        ]
        return max(own, key=lambda d: abs(np.log(max(d.before, 1e-300) / max(d.after, 1e-300))))


def cross_fitted(
    setup: Setup, searched: Callable[[Setup], tuple[ArrayState, ArrayState]]
) -> Gained | None:
    """Predict each half by what a search of the other finds; None where the halves are too small.

    searched : from samples to the fitted base and to the end of the search
    """
    sizes, blocks = list[list[Array]](), list[Index]()
    for half in (setup.first, ~setup.first):
        train, test = part_of(setup, half), part_of(setup, ~half)
        silent = find_voting(test)
        if min(len(train.inner), int(silent.sum())) < FEWEST // _HALVES:
            return None
        sizes.append([_sizes(_predict(end, test), silent) for end in searched(train)])
        blocks.append(test.block[silent])
    before, after = (np.concatenate(parts, axis=1) for parts in zip(*sizes, strict=True))
    block = np.concatenate(blocks)
    return Gained(
        *(
            difference_of_medians(one, two, block, _HALVES)
            for one, two in zip(before, after, strict=True)
        )
    )


def _predict(state: ArrayState, setup: Setup) -> ArrayState:
    """The motion at other samples under positions, terms and noise that were found without them."""
    moved = transfer_to(state, setup)
    if state.clock is not None:
        moved = add_clock(moved, state.clock, voting=False)
    return refit_motion(moved, _FOLLOWED)


def _sizes(state: ArrayState, rows: Flags) -> Array:
    """(2, n, 3 K) m/s² and rad/s: what remains of the samples `rows` (inner,) of accelerometers and
    gyros."""
    off, inner = state.sampled.off, state.setup.inner[rows]
    return np.abs([off.acceleration[inner], off.rate[inner]]).reshape(2, len(inner), -1)


def difference_of_medians(before: Array, after: Array, block: Index, folds: int) -> Difference:
    """Median absolute deviations before and after, and the interval of their difference.

    What changes from block to block is how the board moves, and both errors with it; their ratio
    stays. So the interval is that of the mean logarithm of the ratio over blocks (`difference`), at
    the error before.

    before, after : (n, m) sizes of the errors of n samples; block : (n,) of samples that belong
    together
    """
    every, of = np.unique(block, return_inverse=True)
    ratio = np.array([_log_ratio(before[block == one], after[block == one]) for one in every])
    mean = difference(ratio[of], np.zeros(len(of)), block, folds, "mean")
    start, end = float(np.median(before)), float(np.median(after))
    away = _log_ratio(before, after) - mean.gain
    low, high = (start * -float(np.expm1(-(edge + away))) for edge in (mean.low, mean.high))
    return Difference(start, end, low, high, mean.parts)


def _log_ratio(before: Array, after: Array) -> float:
    one, two = (max(float(np.median(x)), _NO_ERROR) for x in (before, after))
    return float(np.log(one / two))
