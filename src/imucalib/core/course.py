"""A quantity over time, and what is met of it by sensors that lag behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array, Flags

#: Share of a sample that a correction by neighbours' values may feed back from sample to sample.
_FED_BACK = 0.5


@dataclass(frozen=True)
class Course:
    """value, slope, bend : (n, K, 3) a quantity (rad/s or m/s²) and its two derivatives in time;
    plain : the second by differences of the slopes alone
    t : (n,) s; beside : (n, 2) whether the sample before and the one after are neighbours, at the
    usual interval"""

    value: Array
    slope: Array
    bend: Array
    plain: Array
    t: Array
    beside: Flags


def course_of(value: Array, slope: Array, t: Array, beside: Flags) -> Course:
    """Of values and slopes (n, K, 3) at times t (n,) s; beside as in `Course`."""
    bend, plain = bends_of(value, slope, t, beside)
    return Course(value, slope, bend, plain, t, beside)


#: What is met of a course by sensors that lag by (n, K, 1) s.
Lagged = Callable[[Course, Array], Course]


def delay(course: Course, lag: Array) -> Course:
    """What was `lag` (n, K, 1) s before, to the second order.

    The values are those of sensors that are corrected by what comes out. By the bend that values
    of neighbours tell, noise that changes from sample to sample comes back 4 (lag / h)² times as
    large, h the interval; so where that would be more than a half, the differences of the slopes
    take its place by as much.
    """
    bend = course.plain + calm(lag, course) * (course.bend - course.plain)
    slope = course.slope - lag * bend
    return replace(course, value=course.value - 0.5 * lag * (course.slope + slope), slope=slope)


def calm(lag: Array | float, course: Course) -> Array:
    """Share of a second derivative by neighbours' values, for a lag in s, that brings no more than
    half of the noise back to where it comes from."""
    steps = np.diff(course.t)[course.beside[1:, 0]]
    step = float(np.median(steps)) if steps.size else np.inf
    return np.asarray(_FED_BACK / np.maximum(4.0 * (lag / step) ** 2, _FED_BACK))


def slope_of(values: Array, t: Array, beside: Flags) -> Array:
    """(n, ...) derivative of (n, ...) values at times t (n,) s; zero where nothing is beside.

    A difference of neighbours is too small by a sixth of (ω h)², and a lag that is fitted to it as
    much too long: 6 % at 10 Hz and 100 samples a second. These are of the fourth order (Lele 1992,
    J. Comput. Phys. 103): slopes s of neighbours hold (s₋ + 4 s + s₊) / 6 = (x₊ - x₋) / 2 h.
    """
    from scipy.linalg import solve_banded

    before, after = beside.T
    inner = before & after
    at = np.arange(len(t))
    right = np.zeros((len(t), values[0].size))
    flat = values.reshape(len(t), -1)
    bands = np.zeros((3, len(t)))  # above, on and below the diagonal, by columns
    bands[1] = np.where(inner, 4.0 / 6.0, 1.0)
    bands[0, 1:], bands[2, :-1] = inner[:-1] / 6.0, inner[1:] / 6.0
    middle = at[inner]
    right[middle] = _step(flat, t, middle - 1, middle + 1)
    for end, side in ((~before & after, 1), (before & ~after, -1)):
        # Of three samples these would be two equations for one slope.
        whole = end & np.roll(inner, -side) & np.roll(inner, -2 * side)
        n, few = at[whole], at[end & ~whole]
        right[few] = _step(flat, t, few, few + side)
        near, far = flat[n + side], flat[n + 2 * side]
        right[n] = (-2.5 * flat[n] + 2.0 * near + 0.5 * far) / (t[n + side] - t[n])[:, None]
        if side > 0:
            bands[0, n + 1] = 2.0
        else:
            bands[2, n - 1] = 2.0
    return np.asarray(solve_banded((1, 1), bands, right)).reshape(values.shape)


def bends_of(values: Array, slopes: Array, t: Array, beside: Flags) -> tuple[Array, Array]:
    """(n, ...) second derivative of (n, ...) values with known slopes at times t (n,) s, and the
    same by differences of the slopes alone; zero where nothing is beside.

    The first is of the fourth order in an even interval h: a = (x± - x ∓ h x') / h² and b = ±
    (x'± - x') / h of both sides give x'' as the mean of 4 a - b. The mean of b alone is too small
    by a sixth of (ω h)². Of one side b serves: 6 a - 2 b would be of the second order too, at six
    times the noise of the slope.
    """
    out, plain, sides = np.zeros_like(values), np.zeros_like(values), beside.sum(axis=1)
    wide = (-1, *(1 for _ in values.shape[1:]))
    for side, there in zip((-1, 1), beside.T, strict=True):
        n = np.flatnonzero(there)
        h = (t[n + side] - t[n]).reshape(wide)
        both = (sides[n] == 2).reshape(wide)
        a = (values[n + side] - values[n] - h * slopes[n]) / h**2
        b = (slopes[n + side] - slopes[n]) / h
        plain[n] += np.where(both, 0.5, 1.0) * b
        out[n] += np.where(both, 2.0 * a - 0.5 * b, b)
    return out, plain


def _step(flat: Array, t: Array, one: Array, two: Array) -> Array:
    return np.asarray((flat[two] - flat[one]) / (t[two] - t[one])[:, None])
