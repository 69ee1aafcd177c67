"""A model undone over long recordings: tables instead of columns, a few steps instead of Newton's.

    reading = M x + b + N(x) + C(x, covariates)

M and b are what the effects without covariates do to first order, N the rest of those that act on
each axis' input by itself, read from a table of each axis. What remains (C) is evaluated as it is,
some rows at a time. Since N and C are small beside M x, x <- M⁻¹ (reading - b - N(x) - C(x)) closes
in on the answer by the slope of N + C each time.
"""

from __future__ import annotations

import numpy as np

from imucalib.arrays import Array, Flags
from imucalib.core.effect import Context, Effect, Response, Truth
from imucalib.core.model import Model
from imucalib.units import STANDARD_GRAVITY

_ROWS = 8192  # at a time, so that memory does not grow with the recording
_STEP = STANDARD_GRAVITY / 4000.0  # m/s² between the entries of a table about gravity
_NEAR, _FAR = 1.25 * STANDARD_GRAVITY, 32.0 * STANDARD_GRAVITY  # its fine part, and its end
_COARSE = 10.0  # times as wide a step beyond
_ROUNDS, _CLOSE = 25, 1e-7  # steps at most, and m/s² at which a sample is settled
_SMALL = 1e-12  # of what an effect does, below which a part of it is none


class _Table:
    """A function of one number: by its place in the even middle of a grid, by search elsewhere."""

    def __init__(self, grid: Array, values: Array) -> None:
        self._grid, self._values = grid, values
        inside = np.abs(grid) < _NEAR + 0.5 * _STEP
        self._near, self._slope = values[inside][:-1], np.diff(values[inside])
        self._start = float(grid[inside][0])
        self._end = self._start + _STEP * self._slope.size

    def __call__(self, x: Array) -> Array:
        place = (x - self._start) * (1.0 / _STEP)
        cell = place.astype(np.intp)
        np.clip(cell, 0, self._slope.size - 1, out=cell)
        found = self._near[cell] + (place - cell) * self._slope[cell]
        if x.size and (float(x.min()) < self._start or float(x.max()) >= self._end):
            far = (x < self._start) | (x >= self._end)
            found[far] = np.interp(x[far], self._grid, self._values)
        return np.asarray(found)


class Undo:
    """The inverse of a model with its θ, made once for a recording.

    bent : whether it has more than a matrix and offsets, so that it closes in step by step
    """

    def __init__(self, model: Model, theta: Array) -> None:
        bare = Context(1)
        self._slices = model.slices(bare)
        self._theta = theta
        sensor = [e for e in model.effects if e.stage == "sensor"]
        mounting = [e for e in model.effects if e.stage == "mounting"]
        steady = [e for e in sensor if not e.needs]
        self._exact = model if any(e.needs for e in mounting) else None
        late = [e for e in sensor if e.needs]
        # What does not depend on the force is removed once.
        self._free = [e for e in late if isinstance(e, Response) and e.basis_dx is None]
        self._late = [e for e in late if e not in self._free]
        self._offset, self._gain = np.zeros(3), np.eye(3)
        self._tables: list[tuple[int, int, _Table]] = []
        for effect in steady:
            self._offset = self._offset + self._delta(effect, np.zeros((1, 3)), bare)[0]
            self._gain = self._gain + self._slope(effect)
        self._grid = _grid()
        for effect in steady:
            self._take_in(effect)
        self._inverse = np.linalg.inv(self._gain)
        self.bent = bool(self._tables or self._late)
        self._turn = np.eye(3)
        for effect in reversed(mounting):
            act = effect.act(theta[self._slices[effect.name]], Truth(np.zeros((1, 1, 3))), bare)
            self._turn = np.linalg.inv(np.eye(3) + act.d_x[0, 0]) @ self._turn

    def __call__(self, reading: Array, known: Context) -> tuple[Array, Flags]:
        """Readings (n, 3) m/s² corrected to specific force (n, 3), and (n,) whether each was: else
        its linear correction stands. known : covariates of every sample"""
        if self._exact is not None:
            force = self._exact.correct(self._theta, reading[:, None], known)[:, 0]
            return force, np.ones(len(reading), dtype=np.bool_)
        force, settled = np.empty_like(reading), np.empty(len(reading), dtype=np.bool_)
        for start in range(0, len(reading), _ROWS):
            rows = np.arange(start, min(start + _ROWS, len(reading)))
            part = known.take(rows)
            force[rows], settled[rows] = self._some(reading[rows], part)
        return force @ self._turn.T, settled

    def _some(self, reading: Array, known: Context) -> tuple[Array, Flags]:
        linear = (reading - self._offset) @ self._inverse.T
        for effect in self._free:
            linear = linear - self._delta(effect, linear, known) @ self._inverse.T
        x, settled = linear, np.ones(len(reading), dtype=np.bool_)
        if not self.bent:
            return x, settled
        last = np.zeros(len(reading))
        for _ in range(_ROUNDS):
            before, x = x, linear - self._evaluate_nonlinear(x, known) @ self._inverse.T
            moved = np.abs(x - before).max(axis=1)
            # The next step is to this one as this one is to the last: one too small is not made.
            shrunk = np.minimum(moved / np.maximum(last, _CLOSE), 1.0)
            if float((moved * shrunk).max(initial=0.0)) <= _CLOSE:
                return x, settled
            last = moved
        settled = moved <= _CLOSE
        return np.where(settled[:, None], x, linear), settled

    def _evaluate_nonlinear(self, x: Array, known: Context) -> Array:
        """(n, 3) m/s² what is not M x + b."""
        total = np.zeros_like(x)
        for axis, out, table in self._tables:
            total[:, out] += table(x[:, axis])
        for effect in self._late:
            total += self._delta(effect, x, known)
        return total

    def _delta(self, effect: Effect, x: Array, known: Context) -> Array:
        theta = self._theta[self._slices[effect.name]]
        truth = Truth(x[:, None])
        if not isinstance(effect, Response):
            return effect.act(theta, truth, known).delta[:, 0]
        if effect.total is not None:
            return effect.total(theta, truth, known)[:, 0]
        # Without the derivatives, which are most of the work.
        return np.asarray(effect.basis(truth, known)[:, 0] @ theta)

    def _slope(self, effect: Effect) -> Array:
        theta = self._theta[self._slices[effect.name]]
        return np.asarray(effect.act(theta, Truth(np.zeros((1, 1, 3))), Context(1)).d_x[0, 0])

    def _rest(self, effect: Effect, x: Array) -> Array:
        """(n, 3) m/s² beyond its first order."""
        known = Context(len(x))
        return (
            self._delta(effect, x, known)
            - self._delta(effect, 0.0 * x, known)
            - (x @ self._slope(effect).T)
        )

    def _take_in(self, effect: Effect) -> None:
        """Into the tables where it acts on each axis' input by itself, else as it is."""
        probe = STANDARD_GRAVITY * np.random.default_rng(0).uniform(-1.2, 1.2, (64, 3))
        whole = self._rest(effect, probe)
        each = [self._rest(effect, probe * np.eye(3)[axis]) for axis in range(3)]
        size = float(np.abs(whole).max())
        if size <= _SMALL:
            return
        if np.abs(sum(each) - whole).max() > 1e-9 * size:
            first = self._slope(effect)
            self._gain, self._late = self._gain - first, [*self._late, effect]
            self._offset = self._offset - self._delta(effect, np.zeros((1, 3)), Context(1))[0]
            return
        for axis in range(3):
            values = self._rest(effect, self._grid[:, None] * np.eye(3)[axis])
            for out in np.flatnonzero(np.abs(values).max(axis=0) > _SMALL):
                self._tables.append((axis, int(out), _Table(self._grid, values[:, out].copy())))


def _grid() -> Array:
    """Inputs of a table, m/s²: fine where gravity is, coarse beyond."""
    cells = round(_NEAR / _STEP)
    fine = _STEP * np.arange(-cells, cells + 1)
    coarse = np.arange(_NEAR + _COARSE * _STEP, _FAR, _COARSE * _STEP)
    return np.concatenate([-coarse[::-1], fine, coarse])
