"""The posterior at a fitted base model: what may be missing, at all noises that may be.

Before the search the noises are dropped that the data exclude, be the base complete or lack every
free function at once, with gross errors: what a model lacks looks like noise, and what it holds
does not. After it, scans are refined around the values that stand in likely sets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np

from imucalib.arrays import Array
from imucalib.core.balance import Noise, balance
from imucalib.core.eigen import eigen
from imucalib.core.fit import Fit
from imucalib.core.observations import Observations
from imucalib.effects.record_error import GROSS_MG
from imucalib.estimators.least_squares import fit as fit_model
from imucalib.estimators.starting_point import consistent_rows, full_matrix_start
from imucalib.posterior.candidates import SearchedEffects
from imucalib.posterior.odds import AXES, FAR, GROSS, HEARD, LIKELY, REACH, SIZES, UNEVEN
from imucalib.posterior.search.catalogue import (
    Component,
    components_of,
    log_set_prior,
    scan_of,
)
from imucalib.posterior.search.gram import Grams, grams_of
from imucalib.posterior.search.noise import NoiseHypothesis, Terms, between_temperatures, terms_of
from imucalib.posterior.search.problem import Choice, Problem, problem_of
from imucalib.posterior.search.solution import noises_of
from imucalib.posterior.search.space import Posterior, search
from imucalib.posterior.sheet.sheet import Fault
from imucalib.units import MG

#: Rows whose own precision is formed at once; what of the largest product is rounding.
_AT_ONCE, _ROUNDING = 64, 1e-12


@dataclass(frozen=True)
class SearchedPosterior:
    """A base fit with the posterior over what it lacks, at the noises that its leading sets give a
    say.

    every : Grams at all noises that the data do not exclude, be a record what it may
    slips : what was set right in the sheet; aside : (row, probability) of records that are set
    aside, the other wrong ones
    """

    base: Fit
    problem: Problem
    posterior: Posterior
    every: Grams
    slips: tuple[Fault, ...] = ()
    aside: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class SearchStart:
    """A base fit before the search: the problem with all that may be missing, and what its noise
    may be; wanted : what is searched for"""

    base: Fit
    wanted: SearchedEffects
    problem: Problem
    terms: Terms

    @staticmethod
    def of(fit: Fit, wanted: SearchedEffects) -> SearchStart:
        base = _at_nominal_angles(fit)
        problem = problem_of(base, components_of(base.model, base.observations, wanted))
        return SearchStart(base, wanted, problem, terms_of(problem))

    def explore(self) -> SearchedPosterior:
        """The posterior, scans refined where they count."""
        found = self._search()
        values = values_found(found)
        if values:
            data = self.base.observations
            components = components_of(self.base.model, data, self.wanted)
            finer = refine_scans(components, values, data, self.wanted)
            found = replace(self, problem=problem_of(self.base, finer))._search()
        return replace(found, posterior=keep_plausible_noises(found))

    def _search(self) -> SearchedPosterior:
        nothing = np.zeros((len(self.terms.order), 0))
        points, found = self.terms.points, np.zeros(len(self.terms.points), bool)
        for logs in (self.terms.evidence(points, nothing), self._lacking_all):
            found |= logs > logs.max() - HEARD
        grams = grams_of(self.problem, self.terms, [points[k] for k in np.flatnonzero(found)])
        return SearchedPosterior(self.base, self.problem, search(self.problem, grams), grams)

    def axis_noise(self) -> Array:
        """(K, 3) likeliest standard deviations of the axes' noise over each other, in steps, be the
        base complete or lack any one free function, at its prior odds, with gross errors: neither
        an effect on one axis nor a wrong record is its noise."""
        terms = self.terms
        points = [p for p in terms.points if p.walk is None]
        plain = terms.evidence(points, self._gross)
        alone, odds = self._one_function(points[int(plain.argmax())])
        complete, power = self._uneven(self._gross, points[int(plain.argmax())])
        beside = points[int(terms.evidence(points, alone).argmax())]
        lacking, own = self._uneven(alone, beside)
        if lacking + odds > complete:
            power = own
        return np.asarray(np.sqrt(power).reshape(-1, 3))

    def _uneven(self, lacked: Array, point: NoiseHypothesis) -> tuple[float, Array]:
        """Log evidence and variances (K 3,) of the axes, climbed axis by axis from even ones, at
        one noise."""
        terms, rare = self.terms, float(np.log(UNEVEN / (1.0 - UNEVEN) / len(AXES)))
        own, reached = np.ones(terms.axes.shape[1]), float(terms.evidence([point], lacked)[0])
        misfit = terms.base[:, -1] ** 2 @ terms.axes / np.maximum(terms.axes.sum(axis=0), 1e-12)
        for axis in np.argsort(-misfit):
            for step in AXES:
                trial = own.copy()
                trial[axis] = step**2
                relative = trial / np.exp(np.log(trial).mean())  # all of them are the one factor
                evidence = float(terms.evidence([point], lacked, relative)[0])
                evidence += rare * np.count_nonzero(trial != 1.0)
                if evidence > reached:
                    reached, own = evidence, trial
        return reached, own

    @cached_property
    def _gross(self) -> Array:
        """(N, m) factor of gross errors of the records, and of the setting of each dial, that
        belong least to the others."""
        return _gross_errors(self.base)

    @cached_property
    def _everything(self) -> Array:
        """(N, m) factor of every free function that the base may lack, and of gross errors; the
        scatter of sessions holds a law of their temperatures of any size."""
        reach = SIZES[-1] if between_temperatures(self.base.observations) else REACH
        every = (choice.at for choice in self._functions)
        free = np.unique(np.concatenate([np.zeros(0, np.intp), *every]))
        columns = reach * self.problem.columns[: len(self._gross), free]
        return span(np.hstack([columns, self._gross]))

    @cached_property
    def _lacking_all(self) -> Array:
        """(P,) log evidence of the base at every noise that lacks everything."""
        return self.terms.evidence(self.terms.points, self._everything)

    @property
    def _functions(self) -> list[Choice]:
        """Of every free function how it may act."""
        problem = self.problem
        return [c for c in problem.choices if problem.components[c.component].kind == "free"]

    def _one_function(self, point: NoiseHypothesis) -> tuple[Array, float]:
        """(N, m) factor of gross errors and of the free function, at its size, beside which a noise
        is likeliest, and its log prior odds."""
        columns, sizes = self.problem.columns[: len(self._gross)], (REACH, SIZES[-1])
        best, found = -np.inf, (self._gross, 0.0)
        for choice, size in product(self._functions, sizes):
            lacked = np.hstack([self._gross, size * columns[:, choice.at]])
            odds = log_set_prior(self.problem.odds, (choice.component,)) + choice.log_weight
            odds -= float(np.log(len(sizes)))
            reached = odds + float(self.terms.evidence([point], lacked)[0])
            if reached > best:
                best, found = reached, (lacked, odds)
        return found


def span(factor: Array) -> Array:
    """(N, r) with the products W Wᵀ of a factor (N, m), by a column for each of its directions:
    free functions of many things are much alike."""
    values, turn = eigen(factor.T @ factor)
    return np.asarray(factor @ turn[:, values > _ROUNDING * values[-1]])


def search_posterior(fit: Fit, wanted: SearchedEffects) -> SearchedPosterior:
    """The posterior at a fitted base model, scans refined where they count."""
    return SearchStart.of(fit, wanted).explore()


def _at_nominal_angles(fit: Fit) -> Fit:
    """The fit as it stands at the angles that were meant: a tilt that was fitted would be told from
    the reading that it explains, and give a response the blame. Where settings or readings were
    fitted to scatter beyond what hands and chips do, rows are in the wrong place: there θ is that
    of the larger part of the rows that are alike."""
    data, at, prior = fit.observations, fit.at, fit.observations.noise_prior
    if not at.free:
        return fit
    theta, noise = fit.theta, fit.noise
    if prior is None:
        return _as_meant(fit, theta, noise)
    axes, widest = np.median(data.sigma, axis=(0, 1)), float(np.exp(prior.spread))
    noisiest = noise.factor * float(axes.max() / axes.min()) / widest
    scatter = max(noisiest, *(sd / prior.setting for sd in noise.sd[: at.free]))
    if scatter > FAR:
        held = [min(sd, prior.setting) for sd in noise.sd[: at.free]]
        factor = min(max(noise.factor, 1.0), widest)
        noise = Noise(factor, at.component, (*held, *noise.sd[at.free :]))
        alike, start = data.take(consistent_rows(data)), full_matrix_start(fit.model, data)
        again = fit_model(fit.model, alike, start=start, noise=noise)
        theta = theta if again.null_directions else again.theta
    return _as_meant(fit, theta, noise)


def _as_meant(fit: Fit, theta: Array, noise: Noise) -> Fit:
    """A fit at θ and the angles that were meant."""
    meant, data = np.zeros_like(fit.eta), fit.observations
    return replace(
        fit, theta=theta, eta=meant, noise=noise, at=balance(fit.model, theta, meant, data)
    )


def _gross_errors(fit: Fit) -> Array:
    at, n = fit.at, fit.observations.n
    white, basis = fit.white_basis()

    def project(columns: Array) -> Array:
        own = white(columns)
        return np.asarray(own - basis @ (basis.T @ own))

    pulled = white.back(project(at.residual[:, None]))[:, 0]
    rows = np.arange(at.owner.size).reshape(n, -1)
    width, size = rows.shape[1], np.empty(n)
    for some in np.array_split(np.arange(n), -(-n // _AT_ONCE)):
        own = np.zeros((at.owner.size, some.size * width))
        own[rows[some].ravel(), np.arange(some.size * width)] = 1.0
        block = project(own).reshape(-1, some.size, width).transpose(1, 2, 0)
        inner = block @ block.transpose(0, 2, 1) + 1e-9 * np.eye(width)
        pull = pulled[rows[some]]
        size[some] = np.sum(pull * np.linalg.solve(inner, pull[..., None])[..., 0], axis=1)
    worst = rows[np.argsort(size)[-GROSS:]].ravel()
    free = np.zeros((at.owner.size, worst.size))
    free[worst, np.arange(worst.size)] = GROSS_MG * MG / at.unit[worst]
    factors = [free]
    for settings in at.settings[: at.free]:
        power = np.sum(project(settings) ** 2, axis=0)
        k = int(np.argmax((settings.T @ pulled) ** 2 / (power + 1e-9)))
        factors.append(settings[:, k : k + 1])
    return np.hstack(factors)


def refine_scans(
    components: tuple[Component, ...],
    values: Mapping[str, Sequence[str]],
    data: Observations,
    wanted: SearchedEffects,
) -> tuple[Component, ...]:
    """The components, scans with finer values around some."""
    own = {f"{f.name}@": f for f in wanted.families}
    return tuple(
        scan_of(data, own[c.name], values[c.name]) or c if c.name in values else c
        for c in components
    )


def values_found(found: SearchedPosterior) -> dict[str, list[str]]:
    """Values of scans that stand in likely sets, by component."""
    values: dict[str, list[str]] = {}
    problem, posterior = found.problem, found.posterior
    for hypothesis, p in posterior.weighed:
        for pick in hypothesis.picks if p > LIKELY else ():
            choice = problem.choices[pick.choice]
            name = problem.components[choice.component].name
            if name.endswith("@"):
                own = values.setdefault(name, [])
                own += [value for value in choice.member.values(name) if value not in own]
    return values


def keep_plausible_noises(found: SearchedPosterior) -> Posterior:
    """The posterior at the noises that any leading set still gives a say."""
    posterior, problem = found.posterior, found.problem
    weights = [
        noises_of(problem, posterior.grams, h.picks)
        for h in (*posterior.hypotheses[:4], posterior.base)
    ]
    kept = np.flatnonzero(np.max(weights, axis=0) > np.exp(-HEARD / 2.0))
    return replace(posterior, grams=posterior.grams.of(kept))
