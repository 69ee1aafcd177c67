"""Errors on data that was not fitted: each group of observations is left out in turn.

Leaving a group out moves θ by one Gauss-Newton step from the full solution, at the noise of the
full fit: exact for a linear model, and checked against complete refits by the tests. An error is
what a user would see: the corrected reading against the reference, fixture effects taken out.

Which data are left out together: one design, fixed by the data's structure before any search.

Nothing that is chosen or estimated may decide the folds, a seed as little as the outcome: the same
data have the same design, whether something is found or not.

What a search has gained on data that took no part in it: a difference with its interval.

Every part of the design gives one pair of errors, before and after. Parts share most of what they
were trained on, so that their scatter understates how much the gain would vary from one recording
to the next; Nadeau and Bengio (2003) widen it by sqrt(1 + n_test / n_train) in units of the plain
standard error: sqrt(1 + K / (K - 1)) for K folds, where K counts the folds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib.arrays import Array, Index
from imucalib.core.balance import below, whitener
from imucalib.core.effect import Truth
from imucalib.core.fit import Fit
from imucalib.core.model import Model
from imucalib.core.observations import Observations
from imucalib.effects.record_error import is_record_error
from imucalib.posterior.odds import ALONE, CERTAIN, FOLDS, GAP, STRETCH

Metric = Literal["rms", "mean"]
#: What a group must leave of the data's information on every direction, for θ without it to follow
#: from all data's.
_DETERMINED = 1e-8


@dataclass(frozen=True)
class Fold:
    """rows : that are predicted; rest : that choose and fit, with neither the rows nor the gap;
    stretch : whether the rows are one stretch of time, which counts as one number"""

    rows: Index
    rest: Index
    stretch: bool = False


def folds_of(data: Observations) -> tuple[Fold, ...]:
    """The design of some observations.

    Stretches of time (groups of many observations in order) are left out one by one, with a gap on
    both sides. Single positions, or groups of a few that share a setting, are left out one by one
    where they are few, else dealt to ten folds in a fixed shuffle: dealt in turn, a fold would take
    whole rings of a bench that repeats itself. The shuffle starts from what was read, not from the
    order of the rows.
    """
    groups, group = np.unique(data.group, return_inverse=True)
    every = np.arange(data.n)
    if data.n >= STRETCH * groups.size:
        gap = int(np.ceil(GAP * data.n / groups.size))
        stretches = [np.flatnonzero(group == k) for k in range(groups.size)]
        return tuple(
            Fold(rows, every[(every < rows[0] - gap) | (every > rows[-1] + gap)], stretch=True)
            for rows in stretches
        )
    count = groups.size if groups.size <= ALONE else FOLDS
    dealt = np.random.default_rng(groups.size).permutation(np.arange(groups.size) % count)
    key = dealt[_rank(data, group)]
    return tuple(Fold(every[key == k], every[key != k]) for k in range(count))


def _rank(data: Observations, group: Index) -> Index:
    """(n,) the place of each row's group among all, by the groups' mean readings."""
    reading = data.reading.reshape(data.n, -1)
    mean = np.stack([np.bincount(group, weights=c) for c in reading.T]) / np.bincount(group)
    place = np.empty(mean.shape[1], dtype=np.intp)
    place[np.lexsort(mean)] = np.arange(place.size)
    return place[group]


def parts_of(folds: tuple[Fold, ...]) -> Index:
    """(n,) which observations stand for one number: those of a stretch together, others alone."""
    part = np.arange(sum(fold.rows.size for fold in folds))
    for fold in folds:
        if fold.stretch:
            part[fold.rows] = fold.rows[0]
    return part


@dataclass(frozen=True)
class Difference:
    """Held-out error before and after, in the errors' unit.

    gain : before - after; low, high : its 95 % interval, widened for the training data that the
    folds share
    parts : numbers that the interval rests on
    nats, nats_low : what the log density of the rows that were left out has gained, and the lower
        edge of its plain interval over the folds; NaN where it was not computed
    """

    before: float
    after: float
    low: float
    high: float
    parts: int
    nats: float = float("nan")
    nats_low: float = float("nan")

    @property
    def gain(self) -> float:
        return self.before - self.after

    @property
    def holds(self) -> bool:
        """Whether nothing speaks against a correction: the error that is printed has not grown,
        whatever else speaks for it."""
        return self.after <= self.before

    @property
    def proved(self) -> bool:
        """Whether the gain is beyond chance besides, in error or, where rows share setting errors
        that are most of it, in density."""
        return self.holds and (self.low > 0.0 or self.nats_low > 0.0)


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
    reach = _reach_of_certain(max(m - 1, 1))
    wide = float(np.sqrt(1.0 + folds / max(folds - 1, 1)))
    start, end = (float(np.mean(e**power) ** (1.0 / power)) for e in (before, after))
    # rms_b - rms_a is (ms_b - ms_a) / (rms_b + rms_a): the interval of the squares in the unit.
    unit = start + end if metric == "rms" else 1.0
    unit = unit if unit > 0.0 else 1.0
    away = reach * wide * error
    return Difference(start, end, (mean - away) / unit, (mean + away) / unit, m)


def _reach_of_certain(freedom: int) -> float:
    """Standard errors to either end of a 95 % interval of Student's t."""
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.5 + CERTAIN / 2.0))


def add_density(found: Difference, nats: Array) -> Difference:
    """With the gains (K,) in log density, fold by fold."""
    k = nats.size
    error = float(np.std(nats, ddof=1) * np.sqrt(k)) if k > 1 else np.inf
    low = float(nats.sum()) - _reach_of_certain(max(k - 1, 1)) * error
    return replace(found, nats=float(nats.sum()), nats_low=low)


def leaves_determined(every: Array, rest: Array) -> bool:
    """Whether data determine all directions of their parameters without a group of them.

    every, rest : (p, p) information of all, positive definite, and without the group
    """
    lower = np.linalg.cholesky(every)
    inner = below(lower, below(lower, rest).T)
    return bool(np.linalg.eigvalsh(inner).min(initial=1.0) >= _DETERMINED)


@dataclass(frozen=True)
class Predictions:
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

    def of(self, rows: Index) -> Predictions:
        """Those of some observations."""
        return Predictions(self.corrected[rows], self.expected[rows], self.error[rows])

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
    both = np.vstack([both, fit.linearise_known(fit.theta)])
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
    both = np.vstack([both, np.roll(fit.linearise_known(fit.theta), -1, axis=1)])
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


def errors(fit: Fit, theta: Array, observations: Observations) -> Predictions:
    """Corrected against expected for observations under a θ of the fit's model."""
    context, reference = observations.context, observations.reference
    corrected = fit.model.correct(theta, observations.reading, context)
    if reference.directed:
        expected, slices = reference.truth(np.zeros(reference.eta_size)), fit.model.slices(context)
        for effect in fit.model.effects:
            if effect.stage == "fixture":
                own = theta[slices[effect.name]]
                expected = expected + effect.act(own, Truth(expected), context).delta
        return Predictions(corrected, expected, corrected - expected)
    size = np.linalg.norm(corrected, axis=-1, keepdims=True)
    gravity = np.linalg.norm(reference.truth(reference.start(corrected)), axis=-1, keepdims=True)
    return Predictions(corrected, corrected / size * gravity, size - gravity)


def raw_errors(fit: Fit) -> Predictions:
    """The uncorrected readings of a fit against what is known."""
    return errors(replace(fit, model=Model(()), theta=np.zeros(0)), np.zeros(0), fit.observations)


def leave_groups_out(fit: Fit) -> Predictions:
    """Leave each group out in turn and predict it."""
    return _predict_parts(fit, list(each_left_out(fit, fit.observations.group)))


def by_folds(fit: Fit, folds: Sequence[Fold]) -> Predictions:
    """Held-out predictions by the folds of a design, of a model that nothing was chosen for."""
    every = np.arange(fit.observations.n)
    gone = [np.setdiff1d(every, fold.rest) for fold in folds]
    return _predict_parts(
        fit, [(f.rows, theta_without(fit, g)) for f, g in zip(folds, gone, strict=True)]
    )


def _predict_parts(fit: Fit, parts: Sequence[tuple[Index, Array]]) -> Predictions:
    """Predictions of some rows by a θ, part by part."""
    data = fit.observations
    found = [errors(fit, without_records(fit, theta), data.take(rows)) for rows, theta in parts]
    return join(found, [rows for rows, _ in parts])


def join(parts: Sequence[Predictions], rows: Sequence[Index]) -> Predictions:
    """Predictions part by part in the order of the observations; rows : of each part"""
    order = np.argsort(np.concatenate(rows))

    def each(name: str) -> Array:
        return np.asarray(np.concatenate([getattr(part, name) for part in parts])[order])

    return Predictions(each("corrected"), each("expected"), each("error"))


def predict_fitted(fit: Fit) -> Predictions:
    """The same errors on the data that was fitted: for residual tables, never for claims."""
    return errors(fit, without_records(fit, fit.theta), fit.observations)


def without_records(fit: Fit, theta: Array) -> Array:
    """A record's own error is no part of the calibration, so it must not flatter its error."""
    theta = theta.copy()
    for name, part in fit.model.slices(fit.observations.context).items():
        if is_record_error(name):
            theta[part] = 0.0
    return theta
