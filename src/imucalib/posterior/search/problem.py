"""The linear problem: readings less the base model's, and the columns of all that may be missing.

    y = X b + Σ_c C_c u_c + n

Linearised at the fitted base model in units of the declared noise (`core.balance`): one observation
gives three numbers where the direction is known, one where only gravity's size is, and as many more
as there are triads. What is known of the base before the readings stands as rows of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Index
from imucalib.core.effect import Effect
from imucalib.core.fit import Fit, shrink_rows
from imucalib.core.model import Model
from imucalib.effects.record_error import is_record_error
from imucalib.posterior.candidates import effect_slopes, predict_by_fit
from imucalib.posterior.odds import SIZES
from imucalib.posterior.search.catalogue import Component, Member, log_odds


@dataclass(frozen=True)
class Choice:
    """A member among all: its component, its columns in `Problem.columns`, its log weight."""

    component: int
    member: Member
    at: Index
    log_weight: float


@dataclass(frozen=True, kw_only=True)
class Contest:
    """What a search and its words know of a problem beside its products.

    components : that the data can show; choices : every member of every component
    base : how many columns, the first, are free before any component
    """

    components: tuple[Component, ...]
    choices: tuple[Choice, ...]
    base: int

    @cached_property
    def odds(self) -> Array:
        """(C,) log prior odds of each component."""
        return log_odds(self.components)

    @property
    def flat(self) -> tuple[Index, float]:
        """The base model's columns, and that nothing holds them."""
        return np.arange(self.base), np.inf

    @property
    def sizes(self) -> Array:
        """That a component may have, over the noise factor."""
        return SIZES


@dataclass(frozen=True, kw_only=True)
class Problem(Contest):
    """fit : where all is linearised: the base model, or one with what it lacks
    model : the base model; start : (p,) its θ there
    columns : (N, q) base, members, misfit
    owner : (N,) observation of each number, -1 where it is known before the readings
    """

    fit: Fit
    model: Model
    start: Array
    columns: Array
    owner: Index

    @property
    def numbers(self) -> float:
        """How many numbers speak of the noise: the readings', and as many as what is known of the
        base before them settles of its parameters, which then cost none."""
        n = len(self.fit.at.owner)
        own, known = self.columns[:n, : self.base], self.columns[n:, : self.base]
        inner = own.T @ own
        used = np.trace(np.linalg.pinv(inner + known.T @ known, hermitian=True) @ inner)
        return float(n + self.base - used)


def problem_of(fit: Fit, components: tuple[Component, ...], model: Model | None = None) -> Problem:
    """The problem at a fitted model. Members whose columns are zero or not finite, and components
    without a member, are left out.

    model : the base, that of the fit by default: what the fit has beside it is taken back into the
        misfit, so that the linearisation is exact where it stands
    """
    base = model or fit.model
    context = fit.observations.context
    at, slices = fit.at, fit.model.slices(context)
    own = np.concatenate([np.arange(len(fit.theta))[slices[name]] for name in base.names])
    own = own.astype(np.intp)
    more = np.setdiff1d(np.arange(len(fit.theta)), own)
    start = np.array([p.start for p in fit.parameters])
    misfit = at.residual + at.jacobian[:, more] @ (fit.theta - start)[more]
    # What is known of the base before its readings, in units of the noise that the fit has: of a
    # bench's sensor, and of a record that is set aside.
    known = shrink_rows(known_sd(fit) / fit.noise.factor, start - fit.theta)
    blocks = _Blocks(fit, own.size, len(known), components)
    choices, kept = list[Choice](), list[Component]()
    for component in components:
        found = [(m, c) for m in component.members if (c := blocks.of(m)) is not None]
        if found:
            whole = np.log(sum(np.exp(m.log_weight) for m, _ in found))
            choices += [Choice(len(kept), m, c, m.log_weight - whole) for m, c in found]
            kept.append(component)
    n, columns = len(misfit), blocks.columns[:, : blocks.used + 1]
    columns[:n, : own.size], columns[:n, -1] = at.jacobian[:, own], misfit
    columns[n:, : own.size], columns[n:, -1] = known[:, 1 + own], known[:, 0]
    return Problem(
        fit=fit,
        model=base,
        start=fit.theta[own],
        components=tuple(kept),
        choices=tuple(choices),
        columns=columns,
        base=own.size,
        owner=np.concatenate([at.owner, np.full(len(known), -1)]),
    )


class _Blocks:
    """Columns of members, each once: parameters alone and together share theirs.

    first, more : columns before them and rows beneath; columns : with room for all, of which `used`
    """

    def __init__(self, fit: Fit, first: int, more: int, components: tuple[Component, ...]) -> None:
        members = (member for component in components for member in component.members)
        most = {key for member in members for key in member.columns}
        self.columns, self.used = np.zeros((len(fit.at.owner) + more, first + len(most) + 1)), first
        self._fit, self._prediction = fit, predict_by_fit(fit)
        slices = fit.model.slices(fit.observations.context)
        self._slopes = {name: fit.at.jacobian[:, part] for name, part in slices.items()}
        self._place = dict[tuple[str, int, float], int]()

    def of(self, member: Member) -> Index | None:
        """Where the columns of a member stand; None where it does nothing or nothing finite."""
        every = member.columns
        values = np.array(
            [
                self._of(effect)[:, k] * size
                for effect, own, sizes in member.effects
                for k, size in zip(own, sizes, strict=True)
            ]
        )
        if not np.isfinite(values).all() or not values.any():
            return None
        for key, column in zip(every, values, strict=True):
            if key not in self._place:
                self.columns[: column.size, self.used] = column
                self._place[key] = self.used
                self.used += 1
        return np.array([self._place[key] for key in every], dtype=np.intp)

    def _of(self, effect: Effect) -> Array:
        if effect.name not in self._slopes:
            self._slopes[effect.name] = effect_slopes(self._fit, effect, self._prediction)
        return self._slopes[effect.name]


def known_sd(fit: Fit) -> Array:
    """(p,) standard deviation of each parameter of the base before its readings; infinite where
    nothing is known."""
    sd = fit.known_sd
    for name, part in fit.model.slices(fit.observations.context).items():
        if is_record_error(name):
            sd[part] = [p.typical for p in fit.parameters[part]]
    return sd
