"""What accelerometer and gyroscope of one IMU lack, by the one posterior, and what data that took
no part say of it.

The rows of the joint fit, linearised where it stands, are the numbers that the posterior asks for,
the biases and directions of the rests taken out of them (`rows`). Noise points are the floor of a
turn, what grows with its angle, and the scatter of the rests.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.imu.laws import (
    LawTerm,
    components_of_both,
    declare_terms,
    laws_of,
    side_by_side,
    terms_of,
)
from imucalib.calibrators.imu.log import LogCourse
from imucalib.calibrators.imu.request import ImuRequest
from imucalib.calibrators.imu.rows import ReducedRows, TurnNoisePoint, TurnTerms, points_of
from imucalib.core.observations import Observations
from imucalib.effects import known
from imucalib.estimators.turn_log import TurnLog
from imucalib.estimators.turns import ACCELEROMETER, GAIN, TurnFit, fit_turns, leave_out, linearise
from imucalib.posterior.closed_loop.folds import components_heard
from imucalib.posterior.closed_loop.words import SelectedModel, select_model
from imucalib.posterior.odds import HEARD, LEAST, SEARCHES
from imucalib.posterior.search.catalogue import Component
from imucalib.posterior.search.driver import search_until_settled
from imucalib.posterior.search.explored import span
from imucalib.posterior.search.gram import Grams, marginalize, multiply_columns
from imucalib.posterior.search.noise import between_temperatures
from imucalib.posterior.search.problem import Choice, Contest
from imucalib.posterior.search.solution import moments
from imucalib.posterior.search.space import Hypothesis, blocks_of, hill_climb

_FIXED = ACCELEROMETER + GAIN
#: Share of a column's square that the base leaves, below which it is the base's.
_LEFT = 1e-3
#: A joint fit and its terms.
_WithTerms = tuple[TurnFit, tuple[LawTerm, ...]]


@dataclass(frozen=True, kw_only=True)
class TurnProblem(Contest):
    """What a log may lack beside accelerometer and gains. absorbed : names whose columns the base
    takes up; seen : of each component the share of its columns that the base leaves, and their
    length in units of the noise; curves : whether structure without a name is corrected"""

    absorbed: tuple[str, ...]
    seen: tuple[tuple[float, float], ...]
    curves: bool

    def terms_of(self, hypothesis: Hypothesis) -> tuple[LawTerm, ...]:
        """What a set takes into the model, at its sizes: what a calibration can state."""
        picks = ((self.choices[pick.choice], pick.size) for pick in hypothesis.picks)
        return tuple(
            term
            for choice, size in picks
            if self.corrects(choice.component)
            for term in terms_of(choice.member, size)
        )

    def corrects(self, component: int) -> bool:
        """Whether it is corrected where it is told: an effect of the catalogue, with a name or, if
        curves are wanted, without one."""
        one = self.components[component]
        return one.named or (self.curves and known(one.members[0].name) is not None)


@dataclass(frozen=True)
class LawSearch:
    """A base fit, the posterior over what it lacks, what that says, and the fit with it; the terms
    that are declared, and with what is told."""

    base: TurnFit
    lacking: Lacking
    said: SelectedModel[TurnProblem]
    declared: tuple[LawTerm, ...]
    terms: tuple[LawTerm, ...]
    final: TurnFit

    @cached_property
    def heard(self) -> Lacking:
        """What a part of the data may have a say for."""
        every, heard = self.said.problem.components, components_heard(self.said.posterior)
        return self.lacking.among({every[k].name for k in heard})


def joint_fit(
    log: TurnLog, terms: Sequence[LawTerm], course: LogCourse, start: TurnFit | None = None
) -> TurnFit:
    """The joint fit with terms, of the turns that a start has used."""
    sizes = np.concatenate([np.zeros(0), *(t.sizes for t in terms)])
    return fit_turns(
        log,
        laws_of(terms, course),
        sizes=sizes,
        used=None if start is None else start.used,
        start=None if start is None else start.state,
    )


def search_laws(
    base: TurnFit, course: LogCourse, rests: Observations, request: ImuRequest
) -> LawSearch:
    """The posterior over what a base fit lacks, at the set that it says: searched again from where
    that is, until the same is said. rests : as a bench has them"""
    declared = declare_terms(request, course.rests)

    def search(state: _WithTerms) -> tuple[Lacking, SelectedModel[TurnProblem]]:
        lacking = Lacking.of(state[0], declared, course, rests, request)
        problem, grams = lacking.contest(state[0])
        return lacking, select_model(problem, hill_climb(problem, grams))

    def refit(
        _: _WithTerms, found: tuple[Lacking, SelectedModel[TurnProblem]]
    ) -> tuple[_WithTerms, bool]:
        terms = (*declared, *_terms(found[1]))
        told = len(terms) > len(declared)
        return (joint_fit(base.log, terms, course, base) if told else base, terms), False

    settled = search_until_settled(
        (base, declared),
        search,
        refit,
        told=lambda found: _keys((*declared, *_terms(found[1])) if request.loop else declared),
        held=lambda state: _keys(state[1]),
        rounds=SEARCHES,
    )
    (final, terms), (lacking, said) = settled.state, settled.found
    covariance = final.covariance.copy()
    covariance[:_FIXED, :_FIXED] += _between_names(said)
    return LawSearch(
        base=base,
        lacking=lacking,
        said=said,
        declared=declared,
        terms=terms,
        final=replace(final, covariance=covariance),
    )


def _terms(said: SelectedModel[TurnProblem]) -> tuple[LawTerm, ...]:
    return said.problem.terms_of(said.hypothesis)


def _between_names(said: SelectedModel[TurnProblem]) -> Array:
    """(18, 18) by how far other sets that would do have accelerometer and gains from where the
    set that is told has them, in the mean over the posterior."""

    problem, posterior = said.problem, said.posterior

    def fixed(hypothesis: Hypothesis) -> Array:
        blocks = blocks_of(problem.choices, hypothesis.picks)
        return moments(problem, posterior.grams, blocks)[0][:_FIXED]

    told, spread = fixed(said.hypothesis), np.zeros((_FIXED, _FIXED))
    for hypothesis, probability in posterior.weighed:
        if probability > LEAST:
            away = fixed(hypothesis) - told
            spread += probability * np.outer(away, away)
    return spread


def _keys(terms: Sequence[LawTerm]) -> tuple[str, ...]:
    return tuple(sorted(term.key for term in terms))


def refit_without(
    found: LawSearch, turns: Flags, rests: Flags, course: LogCourse, request: ImuRequest
) -> tuple[TurnFit, TurnFit]:
    """Base and final fit without some turns (T,) and what some rests (N,) read, everything chosen
    anew from the products of the others. Where the same is told, the final fit is that of the
    others, linear about the whole."""
    base = leave_out(found.base, turns, rests)
    if not request.loop:
        return base, base
    problem, grams = found.heard.contest(base, found.said.posterior.grams.points)
    new = _terms(select_model(problem, hill_climb(problem, grams)))
    if not new:
        return base, base
    terms = (*found.declared, *new)
    if _keys(terms) == _keys(found.terms):
        sizes = {term.key: term.sizes for term in terms}
        own = np.concatenate([sizes[term.key] for term in found.terms])
        return base, leave_out(found.final, turns, rests, own)
    return base, joint_fit(base.log, terms, course, base)


@dataclass(frozen=True)
class Lacking:
    """Rows of a joint fit with the columns of all that it may lack, each times its size.

    components : these; missing : why effects could not be tried; place : of each column of a
    member where it stands; rows : accelerometer, gains, what is declared (`held` columns, each in
    its sd), then all that is tried; warm : whether a law of the temperature may be what power-ups
    differ by
    """

    components: tuple[Component, ...]
    missing: Mapping[str, str]
    place: Mapping[tuple[str, int, float], int]
    rows: ReducedRows
    held: int
    warm: bool
    curves: bool

    @staticmethod
    def of(
        fit: TurnFit,
        declared: Sequence[LawTerm],
        course: LogCourse,
        rests: Observations,
        request: ImuRequest,
    ) -> Lacking:
        """All that a fit may lack, linearised where it stands."""
        components, missing = components_of_both(fit.log, course, rests, request)
        tried, place = side_by_side(components)
        every = (*declared, *tried)
        sizes = np.concatenate([np.zeros(0), *(term.sizes for term in every)])
        state = replace(fit.state, theta=np.zeros(sizes.size))
        linear = linearise(fit.log, state, laws_of(every, course), sizes)
        held = sum(term.own.size for term in declared)
        rows = ReducedRows.of(replace(fit, state=state, rows=linear))
        return Lacking(
            components=components,
            missing=missing,
            place={key: _FIXED + held + k for key, k in place.items()},
            rows=rows.scale(np.concatenate([np.ones(_FIXED), sizes, np.ones(1)])),
            held=held,
            warm=between_temperatures(rests),
            curves=request.curves,
        )

    def among(self, names: Collection[str]) -> Lacking:
        """Of some of the components."""
        components = tuple(c for c in self.components if c.name in names)
        keys = {key for one in components for m in one.members for key in m.columns}
        kept = {key: k for key, k in self.place.items() if key in keys}
        used = np.r_[: _FIXED + self.held, sorted(kept.values()), -1]
        return replace(
            self,
            components=components,
            place={key: int(np.searchsorted(used[:-1], k)) for key, k in kept.items()},
            rows=self.rows.select(used),
        )

    def contest(
        self, fit: TurnFit, points: Sequence[TurnNoisePoint] = ()
    ) -> tuple[TurnProblem, Grams]:
        """The problem and its products with the turns, rests and weights of a fit. points : noises
        that count, or nothing to find them"""
        terms = TurnTerms(self.rows, fit)
        grams = self._grams(terms, points or self._plausible(terms, fit))
        one = marginalize(grams, (np.arange(_FIXED), np.inf))
        one = one.of(np.array([int(np.argmax(one.log_weight))]))
        choices, absorbed, seen = list[Choice](), list[str](), []
        kept = list[Component]()
        for component in self.components:
            columns = [self._at(member.columns) for member in component.members]
            before = float(np.trace(one.products.blocks(columns[0][None])[0, 0]))
            after = float(np.trace(one.blocks(columns[0][None])[0, 0]))
            if not after > max(_LEFT * before, 1e-12):
                absorbed.append(component.name)
                continue
            choices += [
                Choice(len(kept), member, at, member.log_weight)
                for member, at in zip(component.members, columns, strict=True)
            ]
            seen.append((after / before, float(np.sqrt(after))))
            kept.append(component)
        problem = TurnProblem(
            components=tuple(kept),
            choices=tuple(choices),
            base=_FIXED,
            absorbed=tuple(absorbed),
            seen=tuple(seen),
            curves=self.curves,
        )
        return problem, grams

    def _at(self, columns: Sequence[tuple[str, int, float]]) -> Index:
        return np.array([self.place[key] for key in columns], dtype=np.intp)

    @cached_property
    def _tried(self) -> Flags:
        """(q - 1,) whether a column is one of what may be missing."""
        return np.arange(self.rows.columns.shape[1] - 1) >= _FIXED + self.held

    def _grams(self, terms: TurnTerms, points: Sequence[TurnNoisePoint]) -> Grams:
        covariances = [terms.covariance(point) for point in points]
        log_weight = [
            point.log_prior - 0.5 * v.log_det for point, v in zip(points, covariances, strict=True)
        ]
        solves = tuple(v.solve for v in covariances)
        grams = Grams(
            products=multiply_columns(terms.columns, self.rows.known, solves),
            removed=np.zeros((len(points), 0, terms.columns.shape[1])),
            log_weight=np.array(log_weight),
            numbers=terms.numbers,
            points=tuple(points),
            spread=np.inf,
        )
        return marginalize(grams, (_FIXED + np.arange(self.held), 1.0)) if self.held else grams

    def _plausible(self, terms: TurnTerms, fit: TurnFit) -> list[TurnNoisePoint]:
        """Noise points that neither the base model excludes nor one that lacks everything."""
        points = points_of(fit, between_temperatures=self.warm)
        rich = span(terms.columns[:, :-1][:, self._tried])
        held = terms.columns[:, _FIXED : _FIXED + self.held]
        logs = np.array(
            [terms.evidence(points, _FIXED, lacked) for lacked in (held, np.hstack([held, rich]))]
        )
        counts = (logs > logs.max(axis=1)[:, None] - HEARD).any(axis=0)
        return [points[k] for k in np.flatnonzero(counts)]
