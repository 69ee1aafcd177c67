"""What the array's model lacks, found in its own residuals and kept when held-out parts gain.

Candidates, in the order in which they hide each other: chips on their own clocks (sample age), the
gyros' common frame and delay against the accelerometers. Half of the motion, in blocks, decides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib.calibrators.array_mean_gyro import (
    DELAY,
    FRAME,
    common_gyro,
    gyro_score,
    with_common_gyro,
)
from imucalib.calibrators.array_moving import Moving, samples_of, spread_over
from imucalib.calibrators.array_timing import (
    deviations,
    fit_sample_age,
    rate_slope,
    with_slope,
    without_age,
)
from imucalib.estimators.array_mode import Frame, laplace_frame, start_prior
from imucalib.estimators.array_problem import ArrayPrior
from imucalib.units import DEG

Array = NDArray[np.float64]
Index = NDArray[np.intp]
_BLOCK = 5.0  # s, parts of the motion that are fitted or held out together
_GAIN = 4.0  # nats that a held-out half must gain
_SAMPLES = 1200  # on which the accelerometers are asked
_SHARE = 0.98  # of the gyros' held-out residual that a timing model must get below
NORMAL_MAD = 1.4826


@dataclass(frozen=True)
class ArrayStep:
    """One candidate. value : in words; gain : nats, or the share by which a held-out residual
    falls; accepted : whether it was kept."""

    name: str
    value: str
    held_out: str
    accepted: bool


@dataclass(frozen=True)
class ArrayLoop:
    """steps tried; moving : corrected by those accepted; gyro : deg/s, held-out residual of the
    gyros about their mean before and after (1.4826 times the median absolute deviation)"""

    steps: tuple[ArrayStep, ...]
    moving: Moving
    gyro: tuple[float, float]

    @property
    def accepted(self) -> tuple[ArrayStep, ...]:
        return tuple(step for step in self.steps if step.accepted)


def close_array_loop(moving: Moving, prior: ArrayPrior, sigma: Array) -> ArrayLoop | None:
    """Search, accept on held-out parts, correct. None when the motion is too broken up."""
    slope = rate_slope(moving)
    rows = with_slope(moving, slope)
    if len(rows) < 200:
        return None
    # Neighbouring samples share the beat's phase, so every second one is held out for it.
    before = gyro_residual(moving, rows[1::2])
    steps = [_sample_age(moving, rows)]
    current = steps[0][1]
    for name, part in (("gyro_frame", FRAME), ("gyro_delay", DELAY)):
        steps.append(_common(name, part, current, prior, sigma, rows))
        current = steps[-1][1]
    if steps[1][0].accepted and steps[2][0].accepted:
        # Each was estimated while the other was still there.
        current = _common("gyro_frame", FRAME, current, prior, sigma, rows)[1]
    after = gyro_residual(current, rows[1::2])
    return ArrayLoop(tuple(step for step, _ in steps), current, (before, after))


def gyro_residual(moving: Moving, rows: Index) -> float:
    """deg/s: 1.4826 times the median absolute deviation about the mean of the triads."""
    return float(NORMAL_MAD * np.median(np.abs(deviations(moving)[rows])) / DEG)


def _sample_age(moving: Moving, rows: Index) -> tuple[ArrayStep, Moving]:
    trial = fit_sample_age(moving, rows[::2])
    held = rows[1::2]
    old = gyro_residual(moving, held)
    new = gyro_residual(without_age(moving, trial.age, rows[::2]), held)
    seen = int(np.isfinite(trial.frequency).sum())
    accepted = seen > 0 and trial.span > 0.0 and new < _SHARE * old
    words = "no beat line"
    if seen:
        beats = ", ".join(f"{f:.2f}" for f in trial.frequency)
        words = f"span {1e3 * trial.span:.2f} ms, beats {beats} Hz"
    step = ArrayStep("gyro_sample_age", words, f"{old:.2f} -> {new:.2f} deg/s", accepted)
    if not accepted:
        return step, moving
    return step, without_age(moving, fit_sample_age(moving, rows).age, rows)


def _common(
    name: str, part: slice, moving: Moving, prior: ArrayPrior, sigma: Array, rows: Index
) -> tuple[ArrayStep, Moving]:
    slope = rate_slope(moving)
    used = spread_over(rows, _SAMPLES)
    score = gyro_score(_frame(moving, prior, sigma, used), slope[used])
    first = ((moving.t[used] - moving.t[used[0]]) / _BLOCK).astype(np.intp) % 2 == 0
    one, two = np.flatnonzero(first), np.flatnonzero(~first)
    if min(len(one), len(two)) < 30:
        return ArrayStep(name, "too little motion to hold out a part", "", False), moving
    # Both ways round: each half is predicted by the other.
    gain = score.gain(two, part, score.solved(one, part)[0])
    gain += score.gain(one, part, score.solved(two, part)[0])
    found = common_gyro(score, part)
    if part == DELAY:
        words = f"{1e3 * found.delay:.3f} ± {1e3 * found.delay_sd:.3f} ms"
        words += " that the gyros are early" if found.delay < 0.0 else " that the gyros are late"
    else:
        words = f"largest entry {1e3 * float(np.abs(found.gain).max()):.1f}e-3"
    step = ArrayStep(name, words, f"{gain:+.1f} nats", gain > _GAIN)
    if not step.accepted:
        return step, moving
    return step, with_common_gyro(moving, slope, found, rows)


def _frame(moving: Moving, prior: ArrayPrior, sigma: Array, rows: Index) -> Frame:
    data = samples_of(moving, rows, sigma)
    return laplace_frame(data, start_prior(data, prior))
