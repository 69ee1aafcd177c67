"""What has changed, as a posterior over what may have moved numbers whose covariance is known.

    y = X b + Σ_c C_c u_c + n,   n ~ N(0, Σ_i v_i P_i),   v_i ~ ν_i / χ²(ν_i)

b is what the numbers have in common, with a flat prior, if anything; the components c are what may
have changed, in units of what matters, and noise that is larger than stated. Every part of the
covariance has a size of its own that ν_i degrees of freedom told. With g_i = ν_i / v_i, their sum
and their shares are independent, χ²(Σ ν_i) and Dirichlet(ν_i / 2): the sum is the noise factor that
the evidence integrates out, as if Σ ν_i more numbers had told it; the shares are summed over.

What would be seen has a closed form. Of numbers that a change alone moves the posterior says at
which square z² = cᵀ V⁻¹ c it is told; squares of other numbers are noncentral χ², at a noise that
is as well known as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucalib.arrays import Array
from imucalib.core.eigen import eigen
from imucalib.posterior.odds import ACCUSED, LOOSE, MISSING, NOISES, SEEN_IN, SIZES
from imucalib.posterior.search.catalogue import Component, Kind, Member, log_size_prior
from imucalib.posterior.search.gram import Grams, Multiplied, log_sum, marginalize
from imucalib.posterior.search.problem import Choice, Contest
from imucalib.posterior.search.space import Hypothesis, block_logs, search

#: Singular value of whitened columns, as a share of the largest, below which a direction is none.
_NONE = 1e-6
#: Quantiles of a scale that stand for all of it.
_QUANTILES = (np.arange(24) + 0.5) / 24
#: Name of the component that is noise.
NOISE = "more noise"


def is_told(probability: float) -> bool:
    """Whether what has a probability is likely enough to be told."""
    return probability > ACCUSED * (1.0 - probability)


@dataclass(frozen=True)
class CovariancePart:
    """covariance : (N, N); dof : degrees of freedom of its size"""

    covariance: Array
    dof: float


@dataclass(frozen=True)
class Suspect:
    """What may have moved the numbers.

    name : what it is called
    members : (N, w) columns of each way in which it may act, at a size that matters
    kind : whose prior odds it shares
    """

    name: str
    members: tuple[Array, ...]
    kind: Kind = "name"


@dataclass(frozen=True)
class Explanation:
    """A set of components. names : its suspects and `NOISE`, none where nothing changed; members :
    which of each suspect's; probability : of the set"""

    names: tuple[str, ...]
    members: tuple[int, ...]
    probability: float


@dataclass(frozen=True)
class ChangeAnswer:
    """explanations : likeliest first"""

    explanations: tuple[Explanation, ...]

    @property
    def nothing(self) -> float:
        """Probability that nothing changed."""
        return self.probability_that(lambda names: not names)

    @property
    def told(self) -> bool:
        """Whether a change is likelier than none."""
        return is_told(1.0 - self.nothing)

    @property
    def likeliest(self) -> Explanation:
        """Of all sets that change something."""
        return next(one for one in self.explanations if one.names)

    def of(self, name: str) -> float:
        """Probability of a component, whatever else changed."""
        return self.probability_that(lambda names: name in names)

    def probability_that(self, holds: Callable[[tuple[str, ...]], bool]) -> float:
        """Of all sets of names for which something holds."""
        return float(sum(one.probability for one in self.explanations if holds(one.names)))


@dataclass(frozen=True)
class ChangeQuestion:
    """value : (N,); parts : of its covariance; suspects : what may have moved it
    common : (N, b) columns of what all numbers share; among : questions that share the prior odds,
    of which this is one
    """

    value: Array
    parts: tuple[CovariancePart, ...]
    suspects: tuple[Suspect, ...]
    common: Array
    among: int = 1

    @cached_property
    def covariance(self) -> Array:
        """(N, N) of numbers that nothing moved."""
        return np.asarray(np.sum([part.covariance for part in self.parts], axis=0))

    @cached_property
    def precision(self) -> Array:
        """(N, N) its inverse, with what is common taken out."""
        inverse = np.linalg.inv(self.covariance)
        across = inverse @ self.common
        inner = np.linalg.pinv(self.common.T @ across, hermitian=True)
        return np.asarray(inverse - across @ inner @ across.T)

    @cached_property
    def dof(self) -> float:
        """Of the whole covariance's scale: ν = 1 / Σ share² / ν_part (Satterthwaite 1946,
        Biometrics Bulletin 2, 110-114)."""
        share = np.array([np.sum(self.precision * part.covariance) for part in self.parts])
        share = share / share.sum()
        return float(1.0 / np.sum(share**2 / np.array([part.dof for part in self.parts])))

    def answer(self) -> ChangeAnswer:
        """The posterior over all sets of what may have changed."""
        sets = [
            (one, noisier)
            for noisier in (False, True)
            for one in search(self._contest, self._grams(self.value, noisier=noisier)).hypotheses
        ]
        logs = np.array([self._prior(h.components, n) + h.log_posterior for h, n in sets])
        share = np.exp(logs - log_sum(logs))
        every = [
            Explanation(self._names(h, noisier), self._members(h), float(p))
            for (h, noisier), p in zip(sets, share, strict=True)
        ]
        return ChangeAnswer(tuple(sorted(every, key=lambda one: -one.probability)))

    def find_detectable(self, suspect: int, chance: float = SEEN_IN) -> float:
        """Smallest size, in what matters, of a suspect in the direction that shows least that is
        told with this chance; infinite where it cannot show."""
        from scipy.optimize import brentq
        from scipy.special import chndtr

        known = self._bar(suspect)
        if known is None:
            return float("inf")
        bar, rank, square = known

        def short(size: float) -> float:
            missed = chndtr(bar * self._scale, rank, size**2 * square * self._scale)
            return 1.0 - float(np.mean(missed)) - chance

        high = 6.0 / square**0.5
        while short(high) < 0.0:
            high *= 2.0
        return float(brentq(short, 0.0, high, xtol=1e-3 / square**0.5))

    def false_alarm(self) -> float:
        """Chance, at most, with which a change is told where there is none: the sum of the named
        suspects'."""
        from scipy.special import chdtrc

        named = (k for k, one in enumerate(self.suspects) if one.kind == "name")
        every = [known for k in named if (known := self._bar(k)) is not None]
        return float(sum(np.mean(chdtrc(rank, bar * self._scale)) for bar, rank, _ in every))

    @cached_property
    def _scale(self) -> Array:
        """Quantiles of the noise over its estimate, as the square of its inverse."""
        from scipy.special import gammaincinv

        return np.asarray(2.0 * gammaincinv(0.5 * self.dof, _QUANTILES) / self.dof)

    def _bar(self, suspect: int) -> tuple[float, int, float] | None:
        """`told_from` in the direction that shows least of a suspect, how many numbers it has, and
        z² of a size that matters; None where it cannot show."""
        if suspect not in self._bars:
            one, direction = self.suspects[suspect], self.worst(suspect)
            known = None
            if direction is not None:
                along = one.members[0] @ direction
                square = float(along @ self.precision @ along)
                known = self.find_threshold(along, direction.size), direction.size, square
            self._bars[suspect] = known
        return self._bars[suspect]

    @cached_property
    def _bars(self) -> dict[int, tuple[float, int, float] | None]:
        """Those of `_bar` that were asked for."""
        return {}

    def size_of(self, columns: Array, beside: Sequence[Array]) -> tuple[Array, Array]:
        """(w,) sizes by columns (N, w) and their standard deviations, others (N, w) beside them
        free; NaN where one is open."""
        every, width = np.column_stack([columns, *beside]), columns.shape[1]
        inner = every.T @ self.precision @ every
        scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
        values, vectors = eigen(inner / np.outer(scale, scale))
        if values[0] <= _NONE**2:
            return np.full(width, np.nan), np.full(width, np.nan)
        covariance = (vectors / values) @ vectors.T / np.outer(scale, scale)
        size = covariance @ (every.T @ (self.precision @ self.value))
        return size[:width], np.sqrt(np.diag(covariance)[:width])

    def worst(self, suspect: int) -> Array | None:
        """(w,) the direction in which a suspect's first member shows least; None where it shows
        nothing of one."""
        columns = self.suspects[suspect].members[0]
        values, vectors = eigen(columns.T @ self.precision @ columns)
        open_ = values[0] <= _NONE**2 * max(float(values[-1]), 1e-300)
        return None if open_ else np.asarray(vectors[:, 0])

    def find_threshold(self, along: Array, rank: int) -> float:
        """z² of so many numbers from which on a change is told that moves along (N,), by sets of
        one component, where all other numbers scatter as they are expected to."""
        from scipy.optimize import brentq

        unit = along / float(along @ self.precision @ along) ** 0.5
        rest = 1.0 - (rank + self.common.shape[1]) / unit.size

        def short(log_square: float) -> float:
            return float(np.log(ACCUSED) - self._log_odds(np.exp(0.5 * log_square) * unit, rest))

        low, high = -8.0, 8.0
        return float(np.exp(brentq(short, low, high, xtol=1e-3))) if short(low) > 0.0 else 0.0

    @cached_property
    def _contest(self) -> Contest:
        choices, at = list[Choice](), self.common.shape[1]
        for k, one in enumerate(self.suspects):
            weight = -float(np.log(len(one.members)))
            for columns in one.members:
                own = np.arange(at, at + columns.shape[1])
                choices.append(Choice(k, Member((), weight), own, weight))
                at += own.size
        components = tuple(Component(one.name, one.kind, ()) for one in self.suspects)
        return Contest(components=components, choices=tuple(choices), base=self.common.shape[1])

    def _prior(self, components: tuple[int, ...], noisier: bool) -> float:
        """Log prior beside that of the set without its noise, which says that something is missing
        where it is not empty."""
        own = float(np.log(LOOSE)) if noisier else 0.0
        first = float(np.log(MISSING)) if noisier and not components else 0.0
        return own + first - float(np.log(self.among)) * (noisier or bool(components))

    def _names(self, one: Hypothesis, noisier: bool) -> tuple[str, ...]:
        names = tuple(self.suspects[k].name for k in one.components)
        return (*names, NOISE) if noisier else names

    def _members(self, one: Hypothesis) -> tuple[int, ...]:
        """Numbers of the members, in the order of the components."""
        choices = self._contest.choices
        first = [next(j for j, c in enumerate(choices) if c.component == k) for k in one.components]
        picked = {choices[pick.choice].component: pick.choice for pick in one.picks}
        return tuple(picked[k] - j for k, j in zip(one.components, first, strict=True))

    @cached_property
    def _columns(self) -> Array:
        return np.column_stack([self.common, *(c for s in self.suspects for c in s.members)])

    @cached_property
    def _noises(self) -> tuple[tuple[Array, Array, float], ...]:
        """V⁻¹, products of all columns and log |V| at every noise."""
        dof = np.array([part.dof for part in self.parts])
        share = np.random.default_rng(0).gamma(0.5 * dof, size=(NOISES, dof.size))
        share = share / share.sum(axis=1, keepdims=True)
        sizes = dof / dof.sum() / share if dof.size > 1 else np.ones((1, 1))
        found = []
        for own in sizes:
            parts = [s * p.covariance for s, p in zip(own, self.parts, strict=True)]
            whole = np.asarray(np.sum(parts, axis=0))
            inverse = np.asarray(np.linalg.inv(whole))
            products = self._columns.T @ inverse @ self._columns
            found.append((inverse, products, float(np.linalg.slogdet(whole)[1])))
        return tuple(found)

    def _grams(self, value: Array, *, noisier: bool, rest: float = 0.0) -> Grams:
        """Products of all columns and numbers (N,) at every noise, as stated or larger.

        rest : share of noise beside the numbers
        """
        dof, size = sum(part.dof for part in self.parts), self._columns.shape[1]
        matrix = np.empty((len(self._noises), size + 1, size + 1))
        for own, (inverse, products, _) in zip(matrix, self._noises, strict=True):
            seen = inverse @ value
            own[:size, :size] = products
            own[-1, :size] = own[:size, -1] = self._columns.T @ seen
            own[-1, -1] = value @ seen + rest * float(np.sum(inverse * self.covariance))
        weight = np.array([-0.5 * log_det for *_, log_det in self._noises])
        if noisier:
            larger = 1.0 + SIZES**2
            prior = log_size_prior(SIZES) - 0.5 * value.size * np.log(larger)
            weight = (weight + prior[:, None]).ravel()
            matrix = (matrix / larger[:, None, None, None]).reshape(-1, size + 1, size + 1)
        matrix[:, -1, -1] += dof
        return Grams(
            products=Multiplied(matrix),
            removed=np.zeros((len(matrix), 0, size + 1)),
            log_weight=weight,
            numbers=value.size + dof,
            points=tuple(range(len(matrix))),
            spread=np.inf,
        )

    def _log_odds(self, value: Array, rest: float) -> float:
        """Of all sets of one component against none, with numbers (N,) and a share of noise beside
        them that no component explains."""
        contest, every = self._contest, np.zeros(0)
        stated = marginalize(self._grams(value, noisier=False, rest=rest), contest.flat)
        dof = stated.numbers - contest.base
        for width in {choice.at.size for choice in contest.choices}:
            some = [choice for choice in contest.choices if choice.at.size == width]
            index = np.array([choice.at for choice in some])
            logs, factor = block_logs(stated, index, contest.sizes, dof)
            weight = np.array([c.log_weight + contest.odds[c.component] for c in some])
            scored = logs + log_size_prior(contest.sizes * factor) + weight[:, None]
            every = np.concatenate([every, scored.ravel()])
        noisier = marginalize(self._grams(value, noisier=True, rest=rest), contest.flat)
        noise = float(np.log(LOOSE)) + noisier.evidence(dof)
        changed = float(log_sum(np.append(every, noise))) + float(np.log(MISSING / self.among))
        return changed - stated.evidence(dof)
