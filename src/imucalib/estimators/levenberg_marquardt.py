"""Levenberg-Marquardt on any state that can be linearised and moved.

Column-scaled (Moré 1978), solved by QR so that the normal equations' squared condition never
appears, and finished by plain Gauss-Newton steps down to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
State = TypeVar("State")


@dataclass(frozen=True)
class Solution(Generic[State]):
    """The state found, its residual (N,) and Jacobian (N, p), and whether it has converged."""

    state: State
    residual: Array
    jacobian: Array
    converged: bool
    iterations: int


def minimise(
    linearise: Callable[[State], tuple[Array, Array]],
    move: Callable[[State, Array], State],
    start: State,
    *,
    tolerance: float = 1e-10,
    iterations: int = 200,
) -> Solution[State]:
    """Least squares of residual(state), where d residual = -jacobian · step.

    linearise : state -> (residual (N,), jacobian (N, p) of the *prediction*)
    move : (state, step (p,)) -> state
    tolerance : on the predicted relative change of the cost and on the scaled step
    """
    state = start
    residual, jacobian = linearise(state)
    cost = float(residual @ residual)
    damping, growth = 1e-3, 2.0
    scale = _column_scale(jacobian)
    for iteration in range(1, iterations + 1):
        scale = np.maximum(scale, _column_scale(jacobian))
        step = _damped_step(residual, jacobian, scale, damping)
        predicted = cost - float(np.sum((residual - jacobian @ step) ** 2))
        trial = move(state, step)
        new_residual, new_jacobian = linearise(trial)
        new_cost = float(new_residual @ new_residual)
        usable = np.isfinite(new_cost) and np.isfinite(new_jacobian).all()
        small = predicted <= tolerance * cost or cost == 0.0
        if usable and new_cost <= cost * (1.0 + (1e-14 if small else 0.0)):
            gain = (cost - new_cost) / predicted if predicted > 0.0 else 1.0
            state, residual, jacobian, cost = trial, new_residual, new_jacobian, new_cost
            if small and damping <= 1e-6:
                return _polish(linearise, move, state, residual, jacobian, iteration)
            damping *= max(1.0 / 3.0, 1.0 - (2.0 * gain - 1.0) ** 3) if not small else 0.01
            damping, growth = max(damping, 1e-15), 2.0
        elif small:
            return _polish(linearise, move, state, residual, jacobian, iteration)
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > 1e30:
                break
    return Solution(state, residual, jacobian, False, iterations)


def _column_scale(jacobian: Array) -> Array:
    norms = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    return np.where(norms > 0.0, norms, 1.0)


def _damped_step(residual: Array, jacobian: Array, scale: Array, damping: float) -> Array:
    stacked = np.vstack([jacobian / scale, np.sqrt(damping) * np.eye(scale.size)])
    q, r = np.linalg.qr(stacked)
    return np.asarray(np.linalg.solve(r, q[: residual.size].T @ residual) / scale)


def _polish(
    linearise: Callable[[State], tuple[Array, Array]],
    move: Callable[[State, Array], State],
    state: State,
    residual: Array,
    jacobian: Array,
    iterations: int,
) -> Solution[State]:
    """Gauss-Newton steps for as long as they shrink: takes the last digits that damping costs."""
    last = np.inf
    for _ in range(20):
        scale = _column_scale(jacobian)
        step = np.linalg.lstsq(jacobian / scale, residual, rcond=1e-13)[0] / scale
        size = float(np.linalg.norm(step * scale))
        if not size < 0.9 * last:
            break
        trial = move(state, step)
        new_residual, new_jacobian = linearise(trial)
        before, after = float(residual @ residual), float(new_residual @ new_residual)
        if not after <= before * (1.0 + 1e-9) + 1e-300:
            break
        state, residual, jacobian, last = trial, new_residual, new_jacobian, size
    return Solution(state, residual, jacobian, True, iterations)
