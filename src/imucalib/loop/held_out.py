"""Errors on data that was not fitted: each group of observations is left out in turn.

Leaving a group out moves θ by one Gauss-Newton step from the full solution, at the noise of the
full fit: exact for a linear model, and checked against complete refits by the tests. An error is
what a user would see: the corrected reading against the reference, fixture effects taken out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.balance import whitener
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.core.truth import Truth
from imucalib.effects.record_error import is_record_error
from imucalib.loop.design import Fold

#: What a group must leave of the data's information on every direction, for θ without it to follow
#: from all data's.
_DETERMINED = 1e-8


@dataclass(frozen=True)
class Held:
    """Predictions of observations by fits without their group.

    corrected : (n, K, 3) m/s²; expected : (n, K, 3) the truth of the reference with the fitted
        fixture effects; error : (n, K, d) m/s², the vector difference or the error of the norm
    """

    corrected: Array
    expected: Array
    error: Array

    @property
    def size(self) -> Array:
        """(n,) m/s², length of each observation's error, root mean square over its triads."""
        return np.asarray(np.sqrt(np.mean(np.sum(self.error**2, axis=-1), axis=-1)))

    def of(self, rows: Index) -> Held:
        """Those of some observations."""
        return Held(self.corrected[rows], self.expected[rows], self.error[rows])

    def rms(self, rows: Index | slice = slice(None)) -> float:
        """Root mean square length of the error, m/s²."""
        return float(np.sqrt(np.mean(np.sum(self.error[rows] ** 2, axis=-1))))


def theta_without(fit: Fit, rows: Index) -> Array:
    """θ fitted without some observations, by one step from the full fit."""
    if fit.theta.size == 0:
        return fit.theta
    keep = ~np.isin(fit.at.owner, rows)
    settings = tuple(matrix[keep] for matrix in fit.at.settings)
    white = whitener(settings, fit.noise.ratio)
    both = white(np.column_stack([fit.at.residual[keep], fit.at.jacobian[keep]]))
    both = np.vstack([both, fit.known(fit.theta)])
    scale = np.linalg.norm(both[:, 1:], axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    step = np.linalg.lstsq(both[:, 1:] / scale, both[:, 0], rcond=1e-10)[0] / scale
    return fit.theta + step


def each_left_out(fit: Fit, group: Index) -> Iterator[tuple[Index, Array]]:
    """(observations, θ without them) of each group in turn, group (n,): `theta_without` for all at
    the cost of one.

    With orthonormal Q along the whitened Jacobian and U = L⁻ᵀ [Q z], z the residual, the rest's
    products with Q are those of all less U_g' ((V⁻¹)_gg)⁻¹ U_g, however V couples the rows.
    """
    at, white = fit.at, whitener(fit.at.settings, fit.noise.ratio)
    both = white(np.column_stack([at.jacobian, at.residual]))
    both = np.vstack([both, np.roll(fit.known(fit.theta), -1, axis=1)])
    scale = np.maximum(np.linalg.norm(both[:, :-1], axis=0), 1e-300)
    q, size, turn = np.linalg.svd(both[:, :-1] / scale, full_matrices=False)
    back = turn.T / np.where(size > 0.0, size, 1.0)
    readings = slice(at.residual.size)
    root = None if white.plain else white(np.eye(at.residual.size))
    u = np.column_stack([q, both[:, -1]])[readings]
    u = u if root is None else root.T @ u
    along, closed = q.T @ both[:, -1], size.min(initial=1.0) < _DETERMINED
    keys = group[at.owner]
    for key in np.unique(keys):
        rows, own = np.flatnonzero(group == key), np.flatnonzero(keys == key)
        block = np.eye(own.size) if root is None else root[:, own].T @ root[:, own]
        taken = u[own].T @ np.linalg.solve(block, u[own])
        rest = np.eye(size.size) - taken[:-1, :-1]
        if closed or np.linalg.eigvalsh(rest).min(initial=1.0) < _DETERMINED:
            yield rows, theta_without(fit, rows)
        else:
            step = back @ np.linalg.solve(rest, along - taken[:-1, -1]) / scale
            yield rows, fit.theta + step


def errors(fit: Fit, theta: Array, observations: Observations) -> Held:
    """Corrected against expected for observations under a θ of the fit's model."""
    context, reference = observations.context, observations.reference
    corrected = fit.model.correct(theta, observations.reading, context)
    if reference.directed:
        nominal = reference.truth(np.zeros(reference.eta_size))
        expected = _through_fixture(fit, theta, nominal, observations)
        return Held(corrected, expected, corrected - expected)
    size = np.linalg.norm(corrected, axis=-1, keepdims=True)
    gravity = np.linalg.norm(reference.truth(reference.start(corrected)), axis=-1, keepdims=True)
    return Held(corrected, corrected / size * gravity, size - gravity)


def _through_fixture(fit: Fit, theta: Array, x: Array, observations: Observations) -> Array:
    slices = fit.model.slices(observations.context)
    for effect in fit.model.effects:
        if effect.stage == "fixture":
            own = theta[slices[effect.name]]
            x = x + effect.act(own, Truth(x), observations.context).delta
    return x


def held_out(fit: Fit, observations: Observations | None = None) -> Held:
    """Leave each group out in turn and predict it.

    observations : the same observations with other readings or none left free (default: the
        fit's own); lets a record that was set aside still be judged as recorded
    """
    data = observations or fit.observations
    n = data.n
    parts = [
        (rows, errors(fit, without_records(fit, theta), data.take(rows)))
        for rows, theta in each_left_out(fit, data.group)
    ]
    shapes = [parts[0][1].corrected.shape[1:], parts[0][1].error.shape[1:]]
    corrected, expected = np.zeros((n, *shapes[0])), np.zeros((n, *shapes[0]))
    error = np.zeros((n, *shapes[1]))
    for rows, held in parts:
        corrected[rows], expected[rows], error[rows] = held.corrected, held.expected, held.error
    return Held(corrected, expected, error)


def by_folds(fit: Fit, folds: tuple[Fold, ...]) -> Held:
    """Held-out predictions by the folds of a design, of a model that nothing was chosen for."""
    data = fit.observations
    every = np.arange(data.n)
    parts = []
    for fold in folds:
        theta = without_records(fit, theta_without(fit, np.setdiff1d(every, fold.rest)))
        parts.append(errors(fit, theta, data.take(fold.rows)))
    return joined(parts, folds)


def joined(parts: Sequence[Held], folds: Sequence[Fold]) -> Held:
    """Predictions of every fold in the order of the observations."""
    order = np.argsort(np.concatenate([fold.rows for fold in folds]))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Held(each("corrected"), each("expected"), each("error"))


def fitted(fit: Fit) -> Held:
    """The same errors on the data that was fitted: for residual tables, never for claims."""
    return errors(fit, without_records(fit, fit.theta), fit.observations)


def without_records(fit: Fit, theta: Array) -> Array:
    """A record's own error is no part of the calibration, so it must not flatter its error."""
    theta = theta.copy()
    for name, part in fit.model.slices(fit.observations.context).items():
        if is_record_error(name):
            theta[part] = 0.0
    return theta
