"""The linear problem: readings less the base model's, and the columns of all that may be missing.

    y = X b + Σ_c C_c u_c + n

Linearised at the fitted base model in units of the declared noise (`core.balance`): one observation
gives three numbers where the direction is known, one where only gravity's size is, and as many more
as there are triads. What is known of the base before the readings stands as rows of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit, shrinking
from imucalib.effects.record_error import is_record_error
from imucalib.loop.candidates import effect_slopes, fitted_prediction
from imucalib.loop.posterior.component import Component, Member, log_odds
from imucalib.loop.posterior.odds import SIZES


@dataclass(frozen=True)
class Choice:
    """A member among all: its component, its columns in `Problem.columns`, its log weight."""

    component: int
    member: Member
    at: Index
    log_weight: float


class Contest(Protocol):
    """What a search and its words know of a problem beside its products.

    components, odds, choices : as `Problem` has them; base : how many columns are free before any
    component; flat : these, and the sd of what is known of them; sizes : that a component may have
    """

    @property
    def components(self) -> tuple[Component, ...]: ...
    @property
    def odds(self) -> Array: ...
    @property
    def choices(self) -> tuple[Choice, ...]: ...
    @property
    def base(self) -> int: ...
    @property
    def flat(self) -> tuple[Index, float]: ...
    @property
    def sizes(self) -> Array: ...


@dataclass(frozen=True)
class Problem:
    """fit : the base model, where all is linearised
    components : that the data can show, odds : (C,) log prior odds of each
    choices : every member of every component
    columns : (N, q) base, members, one for each reading's number by itself, misfit; the first
        `base` are the base model's, and `single` is where the readings' own begin
    owner : (N,) observation of each number, -1 where it is known before the readings
    """

    fit: Fit
    components: tuple[Component, ...]
    odds: Array
    choices: tuple[Choice, ...]
    columns: Array
    base: int
    single: int
    owner: Index

    @property
    def flat(self) -> tuple[Index, float]:
        """The base model's columns, and that nothing holds them."""
        return np.arange(self.base), np.inf

    @property
    def sizes(self) -> Array:
        """Those of a component."""
        return SIZES

    def of_rows(self, rows: Index) -> Index:
        """Columns of the numbers of some observations, each by itself: a number that is free is as
        good as one that is not there."""
        return np.asarray(self.single + np.flatnonzero(np.isin(self.owner, rows)), np.intp)

    @property
    def numbers(self) -> float:
        """How many numbers speak of the noise: the readings', and as many as what is known of the
        base before them settles of its parameters, which then cost none."""
        n = len(self.fit.at.owner)
        told, known = self.columns[:n, : self.base], self.columns[n:, : self.base]
        inner = told.T @ told
        used = np.trace(np.linalg.pinv(inner + known.T @ known, hermitian=True) @ inner)
        return float(n + self.base - used)


def problem_of(fit: Fit, components: tuple[Component, ...]) -> Problem:
    """The problem at a fitted base model. Members whose columns are zero or not finite, and
    components without a member, are left out."""
    prediction = fitted_prediction(fit)
    seen: dict[str, Array] = {}

    def slopes(effect: Effect) -> Array:
        if effect.name not in seen:
            seen[effect.name] = effect_slopes(fit, effect, prediction)
        return seen[effect.name]

    blocks, choices, kept = [fit.at.jacobian], list[Choice](), list[Component]()
    at = fit.at.jacobian.shape[1]
    for component in components:
        found = []
        for member in component.members:
            columns = np.concatenate(
                [slopes(effect)[:, own] * size for effect, own, size in member.effects],
                axis=1,
            )
            if not np.isfinite(columns).all() or not columns.any():
                continue
            blocks.append(columns)
            found.append((member, np.arange(at, at + columns.shape[1])))
            at += columns.shape[1]
        if found:
            whole = np.log(sum(np.exp(m.log_weight) for m, _ in found))
            choices += [Choice(len(kept), m, c, m.log_weight - whole) for m, c in found]
            kept.append(component)
    known = _known_before(fit)
    blocks += [np.eye(fit.at.residual.size), fit.at.residual[:, None]]
    columns = np.concatenate(blocks, axis=1)
    rows = np.zeros((len(known), columns.shape[1]))
    rows[:, -1], rows[:, : fit.theta.size] = known[:, 0], known[:, 1:]
    return Problem(
        fit=fit,
        components=tuple(kept),
        odds=log_odds(tuple(kept)),
        choices=tuple(choices),
        columns=np.vstack([columns, rows]),
        base=fit.at.jacobian.shape[1],
        single=at,
        owner=np.concatenate([fit.at.owner, np.full(len(known), -1)]),
    )


def _known_before(fit: Fit) -> Array:
    """(k, 1 + p) values and rows of what is known of the base before its readings, in units of the
    noise that the fit has estimated: of a bench's sensor, and of a record that is set aside."""
    start = np.array([p.start for p in fit.parameters])
    return shrinking(known_sd(fit) / fit.noise.factor, start - fit.theta)


def known_sd(fit: Fit) -> Array:
    """(p,) standard deviation of each parameter of the base before its readings; infinite where
    nothing is known."""
    prior = fit.observations.noise_prior
    sd = np.array(
        [prior.parameters.get(p.name, np.inf) if prior else np.inf for p in fit.parameters]
    )
    for name, part in fit.model.slices(fit.observations.context).items():
        if is_record_error(name):
            sd[part] = [p.typical for p in fit.parameters[part]]
    return sd
