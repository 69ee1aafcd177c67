"""Levenberg-Marquardt on any state that can be linearised and moved.

Column-scaled (Moré 1978), damped by the gain ratio (Nielsen 1999), solved by QR and singular values
so that the normal equations' squared condition never appears, and finished by plain Gauss-Newton
steps down to rounding. Whether it has converged is judged by the undamped step: a damped one is
short anywhere.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from imucalib.arrays import Array

State = TypeVar("State")

#: Singular values below this share of the largest are directions that the data leave open.
_OPEN = 1e-13
#: Share of the cost that an undamped step may still take off, and rms of the residual, in noise
#: units, below which only rounding is left.
_TOLERANCE, _FLOOR = 1e-10, 1e-9
#: A parameter whose column has shrunk to this share ran away to where it does nothing.
_RUNAWAY = 1e-10
_MOST_DAMPING = 1e16
#: Share of the cost below which an undamped step moves nothing by 1e-8 of its standard deviation.
_NOTHING = 1e-18


@dataclass(frozen=True)
class Solution(Generic[State]):
    """The state found, its residual (N,) and Jacobian (N, p), and whether it has converged."""

    state: State
    residual: Array
    jacobian: Array
    converged: bool


@dataclass(frozen=True)
class _Point(Generic[State]):
    """A linearised state. singular, along : singular values of the scaled Jacobian, and the
    residual along their directions; back : (p, p) from those to a step; gain : what the undamped
    step would take off the cost, by the linear model."""

    state: State
    residual: Array
    jacobian: Array
    cost: float
    norms: Array
    singular: Array
    along: Array
    back: Array

    @property
    def gain(self) -> float:
        return float(np.sum(self.along**2))

    def step(self, damping: float) -> Array:
        return np.asarray(self.back @ (self.along * self.singular / (self.singular**2 + damping)))

    def predict(self, damping: float) -> float:
        remaining = damping / (self.singular**2 + damping)
        return float(np.sum(self.along**2 * (1.0 - remaining**2)))


def minimise(
    linearise: Callable[[State], tuple[Array, Array]],
    move: Callable[[State, Array], State],
    start: State,
    *,
    iterations: int = 200,
) -> Solution[State]:
    """Least squares of residual(state), where d residual = -jacobian · step.

    linearise : state -> (residual (N,), jacobian (N, p) of the *prediction*)
    move : (state, step (p,)) -> state
    """
    point = _linearise(linearise, start, np.zeros(0))
    assert point is not None, "the start cannot be evaluated"
    damping, growth, widest, used = 1e-3, 2.0, point.norms, 0
    while used < iterations and point.gain > _TOLERANCE * point.cost and damping < _MOST_DAMPING:
        used += 1
        trial = _move(linearise, move, point, damping, widest)
        if trial is None or trial.cost >= point.cost:
            damping, growth = damping * growth, growth * 2.0
            continue
        ratio = (point.cost - trial.cost) / point.predict(damping)
        damping = max(damping * max(1.0 / 3.0, 1.0 - (2.0 * ratio - 1.0) ** 3), 1e-15)
        point, growth, widest = trial, 2.0, np.maximum(widest, trial.norms)
    point = _polish(linearise, move, point, widest)
    settled = point.gain <= _TOLERANCE * point.cost or point.cost <= _FLOOR**2 * point.residual.size
    kept = bool(np.all(point.norms >= _RUNAWAY * widest))
    return Solution(point.state, point.residual, point.jacobian, settled and kept)


def _linearise(
    linearise: Callable[[State], tuple[Array, Array]], state: State, widest: Array
) -> _Point[State] | None:
    """The state with its singular directions; None where it cannot be evaluated."""
    with np.errstate(over="ignore", invalid="ignore"):
        residual, jacobian = linearise(state)
        cost = float(residual @ residual)
        norms = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
    if not (np.isfinite(cost) and np.isfinite(norms).all()):
        return None
    scale = np.maximum(widest, norms) if widest.size else norms
    scale = np.where(scale > 0.0, scale, 1.0)
    q, r = np.linalg.qr(jacobian / scale)
    u, singular, rows = np.linalg.svd(r, full_matrices=False)
    use = singular > _OPEN * singular.max(initial=0.0)
    along = (u.T @ (q.T @ residual))[use]
    back = rows[use].T / scale[:, None]
    return _Point(
        state=state,
        residual=residual,
        jacobian=jacobian,
        cost=cost,
        norms=norms,
        singular=singular[use],
        along=along,
        back=back,
    )


def _move(
    linearise: Callable[[State], tuple[Array, Array]],
    move: Callable[[State, Array], State],
    point: _Point[State],
    damping: float,
    widest: Array,
) -> _Point[State] | None:
    """The point after a step; None where a step went so far that nothing can be evaluated."""
    try:
        return _linearise(linearise, move(point.state, point.step(damping)), widest)
    except np.linalg.LinAlgError:
        return None


def _polish(
    linearise: Callable[[State], tuple[Array, Array]],
    move: Callable[[State, Array], State],
    point: _Point[State],
    widest: Array,
) -> _Point[State]:
    """Gauss-Newton steps for as long as they shrink: takes the last digits that damping costs.

    Also where the cost has a slightly different minimum than the estimating equation, because
    the weights move with the state.
    """
    for _ in range(20):
        if point.gain <= _NOTHING * point.cost:
            break
        trial = _move(linearise, move, point, 0.0, widest)
        if trial is None or trial.gain > 0.8 * point.gain or trial.cost > 1.001 * point.cost:
            break
        point = trial
    return point
