"""What the gyroscope may do beside its gains, by the one posterior over what is missing.

The rows of the joint fit, linearised where it stands, are the products that the posterior asks for;
the biases and directions of the rests leave them at every noise. Noise points are the floor of a
turn and what grows with its angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imucalib.arrays import Array, Flags, Index
from imucalib.calibrators.array.motion.board_motion import BoardMotion
from imucalib.calibrators.array.motion.laws import array_functions, array_laws
from imucalib.calibrators.imu.log import LogCourse
from imucalib.calibrators.imu.request import ImuRequest, gyro_effects
from imucalib.core.effect import Context, Motion, Response, Truth
from imucalib.estimators.turn_log import TurnLog
from imucalib.estimators.turns import (
    ACCELEROMETER,
    ANGLE_PRIOR,
    GAIN,
    Laws,
    LinearisedTurns,
    TurnFit,
    fit_turns,
    linearise,
    noise_points,
    rests_eliminated,
    variances,
    without,
)
from imucalib.posterior.closed_loop.words import SelectedModel, select_model
from imucalib.posterior.odds import HEARD, LEAST, TOGETHER
from imucalib.posterior.search.catalogue import Component, Kind, Member
from imucalib.posterior.search.gram import Grams, Multiplied, marginalize
from imucalib.posterior.search.problem import Choice, Contest
from imucalib.posterior.search.solution import moments
from imucalib.posterior.search.space import Hypothesis, Posterior, blocks_of, hill_climb
from imucalib.units import DEG, STANDARD_GRAVITY

_FIXED = ACCELEROMETER + GAIN
#: rad, floors of a turn.
_FLOORS = DEG * np.array([0.0, 0.02, 0.05, 0.12, 0.3, 1.0, 4.0])
#: Share of a column's square that the gains leave, below which it is theirs.
_LEFT = 1e-3


class LawTerm(NamedTuple):
    """An effect in the model, or some of its parameters (w,), with the sd of each in its unit."""

    effect: Response
    own: Index
    sizes: Array

    @property
    def name(self) -> str:
        return self.effect.name

    @property
    def key(self) -> str:
        """Which parameters of which effect."""
        return f"{self.name} {self.own}"


def _term_of(member: Member) -> LawTerm:
    ((effect, own, sizes),) = member.effects
    assert isinstance(effect, Response)
    return LawTerm(effect, own, sizes)


@dataclass(frozen=True, kw_only=True)
class TurnProblem(Contest):
    """What turns may lack beside accelerometer and gains. absorbed : names whose columns the gains
    take up; seen : of each component the share of its columns that the gains leave, and their
    length in units of the noise"""

    absorbed: tuple[str, ...]
    seen: tuple[tuple[float, float], ...]

    def terms_of(self, hypothesis: Hypothesis) -> tuple[LawTerm, ...]:
        """What a set takes into the model, at its sizes; laws without a name are not corrected."""
        chosen = ((self.choices[pick.choice], pick.size) for pick in hypothesis.picks)
        terms = (
            (_term_of(choice.member), size)
            for choice, size in chosen
            if self.components[choice.component].named
        )
        return tuple(term._replace(sizes=size * term.sizes) for term, size in terms)


@dataclass(frozen=True)
class LawSearch:
    """A base fit, the posterior over what it lacks, what that says, and the fit with it."""

    base: TurnFit
    lacking: Lacking
    problem: TurnProblem
    posterior: Posterior
    said: SelectedModel
    terms: tuple[LawTerm, ...]
    final: TurnFit


def declared_terms(request: ImuRequest) -> tuple[LawTerm, ...]:
    """Those of the base model, held by no more than ten times their usual size."""
    every = gyro_effects(request.extra_effects)
    return tuple(_term(every[n], 10.0) for n in request.declare if n in every)


def _term(effect: Response, size: float = 1.0) -> LawTerm:
    typical = np.array([p.typical for p in effect.each])
    return LawTerm(effect, np.arange(typical.size), size * typical)


def laws_of(terms: Sequence[LawTerm], course: LogCourse) -> Laws | None:
    """The columns of terms side by side, or None. course : what they may follow"""
    if not terms:
        return None

    def laws(rate: Array, force: Array, t: Array) -> Array:
        truth, context = exposure(rate, force, t, course)
        return np.concatenate(
            [np.asarray(e.effect.basis(truth, context)[:, 0][..., e.own]) for e in terms], axis=2
        )

    return laws


def exposure(rate: Array, force: Array, t: Array, course: LogCourse) -> tuple[Truth, Context]:
    """What effects of a gyroscope act on: rates (n, 3) rad/s in its axes, forces (n, 3) g, at times
    (n,) s."""
    none = np.zeros((len(rate), 1, 3))
    truth = Truth(STANDARD_GRAVITY * force[:, None], Motion(rate[:, None], none, none))
    return truth, course.context(t)


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


def search_laws(base: TurnFit, course: LogCourse, request: ImuRequest) -> LawSearch:
    """The posterior over what a base fit lacks, at the set that it says: searched again from where
    that is, until the same is said."""
    declared = declared_terms(request)
    final, terms, seen = base, declared, set[tuple[str, ...]]()
    while True:
        lacking = lacking_of(final, course, request)
        problem, grams = lacking.contest(final)
        posterior = hill_climb(problem, grams)
        said = select_model(problem, posterior)
        new = problem.terms_of(said.hypothesis)
        if not request.loop or not new or _keys(new) in seen:
            break
        seen.add(_keys(new))
        terms = (*declared, *new)
        final = joint_fit(base.log, terms, course, base)
    if not new:
        final, terms = base, declared
    covariance = final.covariance.copy()
    covariance[:_FIXED, :_FIXED] += _between_names(problem, posterior, said)
    final = replace(final, covariance=covariance)
    return LawSearch(
        base=base,
        lacking=lacking,
        problem=problem,
        posterior=posterior,
        said=said,
        terms=terms,
        final=final,
    )


def _between_names(problem: TurnProblem, posterior: Posterior, said: SelectedModel) -> Array:
    """(18, 18) by how far other sets that would do have accelerometer and gains from where the
    set that is told has them, in the mean over the posterior."""

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


def in_fold(
    found: LawSearch, out: Flags, course: LogCourse, request: ImuRequest
) -> tuple[TurnFit, TurnFit]:
    """Base and final fit without some turns (T,), everything chosen anew from the products of the
    others. Where the same is told, the final fit is that of the others, linear about the whole."""
    base = without(found.base, out)
    if not request.loop:
        return base, base
    problem, grams = found.lacking.contest(base)
    new = problem.terms_of(select_model(problem, hill_climb(problem, grams)).hypothesis)
    if not new:
        return base, base
    terms = (*declared_terms(request), *new)
    if _keys(terms) == _keys(found.terms):
        sizes = {term.key: term.sizes for term in terms}
        own = np.concatenate([sizes[term.key] for term in found.terms])
        return base, without(found.final, out, own)
    return base, joint_fit(base.log, terms, course, base)


@dataclass(frozen=True)
class Lacking:
    """Rows of a joint fit with the columns of all that it may lack, in typical sizes.

    missing : why effects could not be tried; tried : an effect a block of the columns, after the
    `held` ones of the base; prior : (m,) sd of all; power_ups : columns of theirs
    """

    components: tuple[Component, ...]
    missing: Mapping[str, str]
    tried: tuple[Response, ...]
    rows: LinearisedTurns
    prior: Array
    held: int
    power_ups: Index

    def contest(self, fit: TurnFit) -> tuple[TurnProblem, Grams]:
        """The problem and its products with the turns, weights and noise of a fit."""
        grams = self._grams(fit)
        first = _FIXED + np.cumsum([0, *(len(effect.each) for effect in self.tried)])
        place = {effect.name: int(k) for effect, k in zip(self.tried, first, strict=False)}
        one = marginalize(grams, (np.arange(_FIXED), np.inf))
        one = one.of(np.array([int(np.argmax(one.log_weight))]))
        choices, absorbed, seen = list[Choice](), list[str](), []
        kept = list[Component]()
        for component in self.components:
            terms = [_term_of(member) for member in component.members]
            columns = [place[term.name] + term.own for term in terms]
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
        )
        return problem, grams

    def _grams(self, fit: TurnFit) -> Grams:
        """All but accelerometer, gains, columns and y taken out, at the noise points that count."""
        size = self.rows.jacobian.shape[1]
        held = np.r_[_FIXED : _FIXED + self.held, self.power_ups]
        tried = np.arange(_FIXED + self.held, _FIXED + self.prior.size)
        kept = np.concatenate([np.arange(_FIXED), tried, [size]])
        points = noise_points(fit.log, fit.noise)
        every, logs = rests_eliminated(
            self.rows,
            fit.log,
            variances(fit.log, fit.noise, self.prior),
            np.concatenate([held, kept]),
            np.where(fit.used, fit.weight, 0.0) / points,
        )
        root = np.linalg.cholesky(every[:, : held.size, : held.size])
        across = np.linalg.solve(root, every[:, : held.size, held.size :])
        matrices = every[:, held.size :, held.size :] - across.swapaxes(1, 2) @ across
        logs += np.log(np.diagonal(root, axis1=1, axis2=2)).sum(axis=1)
        logs += np.log(points[:, fit.used]).sum(axis=1)  # of two numbers a turn, the half
        weights = np.tile(np.log(ANGLE_PRIOR), len(points) // len(ANGLE_PRIOR)) - logs
        numbers = 2.0 * fit.used.sum() + 4.0 * fit.log.rests - 3.0
        grams = Grams(
            products=Multiplied(matrices),
            removed=np.zeros((len(matrices), 0, kept.size)),
            log_weight=weights - weights.max(),
            numbers=numbers,
            points=(None,) * len(matrices),
            spread=np.inf,
        )
        return grams.of(_plausible_noises(grams, numbers - _FIXED))


def _plausible_noises(grams: Grams, dof: float) -> Index:
    """Noise points that neither the base model excludes nor one that lacks everything."""
    base = marginalize(grams, (np.arange(_FIXED), np.inf))
    rich = marginalize(base, (np.arange(_FIXED, grams.removed.shape[2] - 1), 1.0))
    logs = np.array([g.log_weight + g.log_noise(g.power, dof) for g in (base, rich)])
    return np.flatnonzero((logs > logs.max(axis=1)[:, None] - HEARD).any(axis=0))


def lacking_of(fit: TurnFit, course: LogCourse, request: ImuRequest) -> Lacking:
    """All that a fit may lack, linearised where it stands."""
    components, missing = _components(fit.log, course, request)
    declared = declared_terms(request)
    effects = (_term_of(member).effect for c in components for member in c.members)
    tried = tuple(dict.fromkeys(effects))
    whole = tuple(map(_term, tried))
    held, sizes = (np.concatenate([np.zeros(0), *(t.sizes for t in p)]) for p in (declared, whole))
    prior = np.concatenate([held, np.full(sizes.size, np.inf)])
    state = replace(fit.state, theta=np.zeros(prior.size))
    rows = linearise(fit.log, state, laws_of((*declared, *whole), course), prior)
    scale = np.ones(rows.jacobian.shape[1])
    scale[_FIXED + held.size : _FIXED + prior.size] = sizes
    return Lacking(
        components=components,
        missing=missing,
        tried=tried,
        rows=replace(rows, jacobian=rows.jacobian.multiply(scale).tocsr()),
        prior=prior,
        held=held.size,
        power_ups=np.arange(state.first_offset, state.first_drift),
    )


def _components(
    log: TurnLog, course: LogCourse, request: ImuRequest
) -> tuple[tuple[Component, ...], dict[str, str]]:
    """Names, unnamed laws and free functions of the gyroscope; and why effects could not be
    tried."""
    t, rate, force = (
        np.concatenate([getattr(turn, name) for turn in log.turns])
        for name in ("t", "rate", "force")
    )
    truth, context = exposure(rate, force, t, course)
    found: dict[str, tuple[Kind, str, list[Response]]] = {}
    missing, out = {}, (*request.declare, *request.without)
    for name, effect in gyro_effects(request.extra_effects).items():
        if name in out or (request.only and name not in request.only):
            continue
        if reason := effect.missing(context):
            missing[name] = reason
        else:
            found[name] = "name", "", [effect]
    motion = BoardMotion(truth, context)
    for follows, law in array_laws(motion) if not request.only else ():
        if law.channel == "angular_rate" and not law.lagged:
            found.setdefault(f"another law of {follows}", ("law", follows, []))[2].append(law)
    for follows, free in array_functions(motion) if not request.only else ():
        if free.channel == "angular_rate":
            found[free.name] = "free", follows, [free]
    components = (
        Component(
            name,
            kind,
            tuple(
                Member((term,), share - np.log(len(effects)))
                for effect in effects
                for term, share in _members(effect, kind)
            ),
            follows,
        )
        for name, (kind, follows, effects) in found.items()
    )
    return tuple(components), missing


def _members(effect: Response, kind: Kind) -> list[tuple[LawTerm, float]]:
    """All of its parameters together, or one alone, each with its share in logs."""
    whole = _term(effect)
    count = whole.own.size
    if kind == "free" or count == 1:
        return [(whole, 0.0)]
    one = float(np.log((1.0 - TOGETHER) / count))
    alone = (LawTerm(effect, whole.own[[k]], whole.sizes[[k]]) for k in range(count))
    return [(whole, float(np.log(TOGETHER))), *((term, one) for term in alone)]
