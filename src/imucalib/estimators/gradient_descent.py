"""Paper 002's own estimator, and the two that it compares with, on points (N, 3) in g.

corrected = K (v + o), K lower triangular (eqs. (1), (7)-(9)); p = (k_xx, k_yy, k_zz, k_xy, k_xz,
k_yz, o_x, o_y, o_z). The objective is the mean of (|corrected|² - 1)²: eq. (12) prints a sum, with
which the printed learning rates diverge. Gradients are forward differences (13), steps h of 1e-5,
or 0.01 in 16 bits, where they shift the minimum by about h/2.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array
from imucalib.errors import NotConverged, Undetermined

Integers = NDArray[np.int64]

START = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
#: Learning rates of scale, misalignment and offset (section II.C), for the objective without root.
RATES = np.repeat([0.3, 0.8, 0.2], 3)
_ITERATIONS, _STEP = 50, 1e-5


@dataclass(frozen=True)
class FixedPoint:
    """Arithmetic of a microcontroller: operands of `bits`, products and sums of twice as many.

    fraction : bits after the point; step : h of the gradient, in units of the last bit
    """

    bits: int
    fraction: int
    step: int

    @property
    def one(self) -> int:
        return 1 << self.fraction


#: h is 1e-5 in 32 bits and 0.01 in 16 bits, as the paper chose them.
INT32 = FixedPoint(32, 28, round(_STEP * (1 << 28)))
INT16 = FixedPoint(16, 13, round(0.01 * (1 << 13)))


def apply(p: NDArray[Any], points: NDArray[Any]) -> NDArray[Any]:
    """Corrected points (N, 3) in g: eqs. (7)-(9). Integers give the products, not shifted back."""
    x, y, z = (points + p[6:]).T
    return np.stack([p[0] * x, p[3] * x + p[1] * y, p[4] * x + p[5] * y + p[2] * z], axis=-1)


def objective(p: Array, points: Array) -> float:
    """Mean of (|corrected|² - 1)², without a square root."""
    return float(np.mean((np.sum(apply(p, points) ** 2, axis=1) - 1.0) ** 2))


def descend(points: Array) -> Array:
    """p (9,) in floating point. Raises NotConverged when it diverges."""
    p = START.copy()
    for _ in range(_ITERATIONS):
        here = objective(p, points)
        slope = np.array([(objective(p + _STEP * e, points) - here) / _STEP for e in np.eye(9)])
        p = p - RATES * slope
        if not np.isfinite(p).all() or np.abs(p).max() > 10.0:
            raise _diverges()
    return p


def descend_fixed(points: Array, form: FixedPoint) -> Array:
    """p (9,) in integers only, every bit as a microcontroller computes it; no square root.

    Raises NotConverged when a number outgrows its bits.
    """
    v = np.round(points * form.one).astype(np.int64)
    p = np.round(START * form.one).astype(np.int64)
    rates = np.round(RATES * form.one).astype(np.int64)
    for _ in range(_ITERATIONS):
        here = _sum_fixed(p, v, form)
        for_each = form.step * np.eye(9, dtype=np.int64)
        change = np.array([_sum_fixed(p + e, v, form) - here for e in for_each])
        slope = _divide(change, form.step * len(v))
        p = p - _shift_right(rates * slope, form.fraction)
        _demand(p, form.bits)
    return np.asarray(p / form.one)


def _sum_fixed(p: Integers, v: Integers, form: FixedPoint) -> int:
    """Sum of squares of (|corrected|² - 1), with twice the fraction bits."""
    corrected = _shift_right(apply(p, v), form.fraction)
    _demand(corrected, form.bits)
    excess = _shift_right(np.sum(corrected * corrected, axis=1), form.fraction) - form.one
    _demand(excess, form.bits)
    total = np.sum(excess * excess)
    _demand(total, 2 * form.bits)
    return int(total)


def _shift_right(values: Integers, bits: int) -> Integers:
    """Right shift, rounded to nearest."""
    return np.asarray((values + (1 << (bits - 1))) >> bits)


def _divide(values: Integers, divisor: int) -> Integers:
    """Division rounded to nearest, halves away from zero, as integer units do it."""
    return np.asarray(np.sign(values) * ((np.abs(values) + divisor // 2) // divisor))


def _demand(values: Integers, bits: int) -> None:
    if np.abs(values).max() >= 1 << (bits - 1) - (bits == 64):
        raise _diverges()


def _diverges() -> NotConverged:
    return NotConverged(
        "the gradient descent left the range of its numbers",
        remedy="the points are not in g, or not at rest",
    )


def solve_closed_form(points: Array) -> Array:
    """p (9,) of the non-iterative method of Gietzelt et al. (2013): scale and offset by one linear
    least squares for an ellipsoid along the axes; no misalignment.

    Raises Undetermined when the points lie on no ellipsoid.
    """
    design = np.column_stack([points**2, points])
    found, _, rank, _ = np.linalg.lstsq(design, np.ones(len(points)), rcond=1e-10)
    square, line = found[:3], found[3:]
    if rank < 6 or np.any(square <= 0.0):
        raise Undetermined("the points lie on no ellipsoid", remedy="collect more postures")
    centre = -line / (2.0 * square)
    size = 1.0 + float(np.sum(square * centre**2))
    return np.concatenate([np.sqrt(square / size), np.zeros(3), -centre])


def global_optimum(points: Array, seed: int = 0) -> Array:
    """p (9,) by differential evolution on the same objective, the paper's second comparison."""
    from scipy.optimize import differential_evolution

    bounds = [(0.8, 1.2)] * 3 + [(-0.15, 0.15)] * 3 + [(-0.2, 0.2)] * 3
    # SciPy before 1.15 knows no `rng`, and every one takes a generator as `seed`.
    chance = np.random.default_rng(seed)
    found = differential_evolution(
        objective, bounds, args=(points,), seed=chance, tol=1e-10, maxiter=300, popsize=10
    )
    return np.asarray(found.x, np.float64)


METHODS: dict[str, Callable[[Array], Array]] = {
    "gradient descent": descend,
    "gradient descent, 32-bit": lambda points: descend_fixed(points, INT32),
    "gradient descent, 16-bit": lambda points: descend_fixed(points, INT16),
    "non-iterative": solve_closed_form,
    "global": global_optimum,
}


def norm_errors(p: Array, points: Array) -> Array:
    """(N,) |corrected| - 1 in g."""
    return np.asarray(np.linalg.norm(apply(p, points), axis=1) - 1.0)


def mean_error(p: Array, points: Array) -> float:
    """g, mean of the absolute errors; NaN without points."""
    return float(np.mean(np.abs(norm_errors(p, points)))) if len(points) else float("nan")


def improvement(p: Array, points: Array) -> float:
    """R of eq. (21) in per cent, on the means of the absolute errors."""
    return 100.0 * mean_error(START, points) / max(mean_error(p, points), 1e-12)
