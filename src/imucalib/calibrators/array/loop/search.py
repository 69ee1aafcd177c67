"""The search over a motion: settle a set, make its products, search from it, until it stands.

Effects whose columns are the same to the first order, told apart by refits: delays and
low-passes.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucalib.arrays import Array
from imucalib.calibrators.array.loop.ages import Ages, found_ages, kept_ages, with_phases
from imucalib.calibrators.array.loop.catalogue import Asked, array_catalogue, twins_of
from imucalib.calibrators.array.loop.declared import (
    beside_the_fit,
    shared_by_neighbours,
    with_declared,
)
from imucalib.calibrators.array.loop.laws import Way
from imucalib.calibrators.array.loop.products import MotionProblem, products
from imucalib.calibrators.array.loop.setup import Setup, motion_at
from imucalib.calibrators.array.loop.state import ArrayState, settled
from imucalib.calibrators.array.loop.terms import Term, determined
from imucalib.calibrators.array.moving import Moving
from imucalib.core.effect import Response
from imucalib.estimators.array.noise import SensorNoise, log_density
from imucalib.estimators.array.samples import Weights, fit_samples
from imucalib.loop.posterior.gram import Grams
from imucalib.loop.posterior.space import Posterior, climbed
from imucalib.loop.posterior.words import Conclusion, concluded

#: Times that twins are told apart, where some have gone to another name.
_PASSES = 3


@dataclass(frozen=True)
class Apart:
    """state : with the likeliest of every effect's twins; shares : name in it -> (twin, share) of
    what may stand there, itself first"""

    state: ArrayState
    shares: Mapping[str, tuple[tuple[str, float], ...]]


def told_apart(state: ArrayState, left_out: Collection[str]) -> Apart:
    """Of a settled fit, every found effect that has twins against these, each fitted anew in its
    place; again where one has gone to a twin, for beside a wrong one another seems right.

    left_out : names that are not tried. A twin whose fit is lost keeps the share it had before:
    nothing is known against it.
    """
    for _ in range(_PASSES):
        shares = dict[str, tuple[tuple[str, float], ...]]()
        names = [t.name for t in state.found]
        for name in names:
            twins = [twin for twin in twins_of(name) if twin not in left_out]
            if twins:
                state, known = _against(state, name, twins)
                shares[known[0][0]] = known
        if names == [t.name for t in state.found]:
            break
    return Apart(state, shares)


def _against(
    state: ArrayState, name: str, twins: list[str]
) -> tuple[ArrayState, tuple[tuple[str, float], ...]]:
    """The fit with the likeliest of an effect and its twins, and the share of each."""
    possible = [twin for twin in twins if _possible(state, name, twin)]
    fits: dict[str, ArrayState | None] = {name: state}
    fits |= {twin: _in_place(state, name, twin) for twin in possible}
    level = _nats(state, name)
    nats = np.array([_nats(s, n) - level if s else 0.0 for n, s in fits.items()])
    share = np.exp(nats - nats.max())
    order = np.argsort(-share, kind="stable")
    names = [list(fits)[k] for k in order]
    known = zip(names, share[order] / share.sum(), strict=True)
    return fits[names[0]] or state, tuple((n, float(s)) for n, s in known)


def refitted(state: ArrayState) -> ArrayState | None:
    """The joint fit with the noise in the shape that it has; None where it runs away."""
    try:
        found = settled(state, shaped=False)
    except np.linalg.LinAlgError:
        return None
    return found if found.converged else None


def _in_place(state: ArrayState, name: str, twin: str) -> ArrayState | None:
    terms = (_as_twin(t, twin) if t.name == name else t for t in state.terms)
    return refitted(replace(state, terms=tuple(terms)))


def _possible(state: ArrayState, name: str, twin: str) -> bool:
    """Whether the values of an effect are those that its twin could have: no filter has a negative
    time."""
    term = next(t for t in state.terms if t.name == name)
    least = _each(_as_twin(term, twin), "least")
    return bool(np.all(_as_twin(term, twin).theta + 3.0 * state.sd_of(term) >= least))


def _each(term: Term, what: str) -> Array:
    return np.resize([getattr(p, what) for p in term.effect.each], len(term.theta))


def _effect(name: str) -> Response:
    return array_catalogue()[name.partition("@")[0]]


def _as_twin(term: Term, twin: str) -> Term:
    """With the effect of a twin: where one kind of sensor lags, the other leads."""
    effect = _effect(twin)
    sign = 1.0 if effect.channel == term.effect.channel else -1.0
    return replace(term, name=twin, effect=effect, value=sign * term.value)


def _nats(state: ArrayState, name: str) -> float:
    """Log density of the residuals, neighbours counted for what they are worth. A lag of single
    sensors shows against others of their kind: what neighbours' noise brings into dω/dt, other for
    each twin, is in the other kind's residuals, and was worth 36 nats for the wrong one."""
    effect = _effect(name)
    *squares, speed = state.squares()
    return sum(
        float(log_density(noise, square, speed).sum()) / shared_by_neighbours(state, gyro=gyro)
        for noise, square, gyro in zip(state.noise, squares, (False, True), strict=True)
        if effect.shared or gyro == (effect.channel == "angular_rate")
    )


#: Times that a set is settled and searched from: two do, three at most on measured motions.
_ROUNDS = 5
DIVERGED = "its refit did not converge"


@dataclass(frozen=True)
class Explored:
    """Where a search stands.

    base : the fit before it; apart : with what is told in the model, twins told apart; ages : of
        the gyros' clocks
    problem, grams, posterior, said : of the last search, and first : of the first
    rejected : (name, reason) of what the model could not take in
    """

    base: ArrayState
    apart: Apart
    ages: Ages | None
    problem: MotionProblem
    grams: Grams
    posterior: Posterior
    said: Conclusion
    first: tuple[MotionProblem, Posterior]
    rejected: tuple[tuple[str, str], ...] = ()


def explored(
    base: ArrayState, ages: Ages | None, moving: Moving, asked: Asked, *, curves: bool = False
) -> Explored:
    """The posterior over what a fitted state lacks, at the set that it tells.

    asked : declared effects stay in the model; curves : whether what has no name is corrected
    """
    left_out = asked.skipped(base.setup.imus)
    apart, seen, found = Apart(base, {}), set[frozenset[str]](), None
    for _ in range(_ROUNDS):
        problem, grams = products(apart.state, left_out, asked.declare)
        found = _searched(base, apart, ages, problem, grams, found, names_first=not curves)
        ways = problem.ways_of(found.said.hypothesis)
        names = frozenset(w.name for w in ways)
        if names == _names(apart.state, asked) or names in seen:
            break
        seen.add(names)
        grown, lost = with_ways(apart.state, ways, asked)
        if grown is None:
            return replace(found, rejected=tuple((name, DIVERGED) for name in lost))
        state, ages = _aged(grown, ages, moving)
        apart = told_apart(refitted(state) or grown, left_out)
    assert found is not None
    return replace(found, apart=apart, ages=ages)


def _searched(
    base: ArrayState,
    apart: Apart,
    ages: Ages | None,
    problem: MotionProblem,
    grams: Grams,
    before: Explored | None,
    *,
    names_first: bool,
) -> Explored:
    posterior = climbed(problem, grams, problem.picks(apart.state))
    first = (problem, posterior) if before is None else before.first
    said = concluded(problem, posterior, names_first=names_first)
    return Explored(
        base=base,
        apart=apart,
        ages=ages,
        problem=problem,
        grams=grams,
        posterior=posterior,
        said=said,
        first=first,
    )


def _names(state: ArrayState, asked: Asked) -> frozenset[str]:
    return frozenset(t.name for t in state.found if t.name not in asked.declare)


def with_ways(
    state: ArrayState, ways: tuple[Way, ...], asked: Asked
) -> tuple[ArrayState | None, tuple[str, ...]]:
    """The joint fit with these and what is declared, and no others; or None, with the names that
    it was to take in."""
    names = {way.name for way in ways}
    kept = (t for t in state.terms if not t.found or t.name in names or t.name in asked.declare)
    grown = replace(state, terms=tuple(kept))
    new = [way for way in ways if way.name not in {t.name for t in grown.terms}]
    for way in new:
        term = _term(grown, way)
        if term.value.size:
            grown = replace(grown, terms=(*grown.terms, term))
    try:
        grown = settled(with_phases(grown))
    except np.linalg.LinAlgError:
        return None, tuple(way.name for way in new)
    return (grown if grown.converged else None), tuple(way.name for way in new)


def _term(state: ArrayState, way: Way) -> Term:
    matrix = beside_the_fit(state, way.effect, way.only)
    return determined(way.name, way.effect, way.only, matrix, state.found)


def _aged(state: ArrayState, ages: Ages | None, moving: Moving) -> tuple[ArrayState, Ages | None]:
    """Clocks again, once what had hidden them is known."""
    again = found_ages(state, moving)
    if again is None:
        return state, ages
    return kept_ages(state, again, voting=True), again


def started(
    setup: Setup, terms: tuple[Term, ...], moving: Moving, asked: Asked
) -> tuple[ArrayState, Ages | None]:
    """The base model on some samples, with what is declared, and the clocks that it shows."""
    base = with_declared(start_state(setup, terms), asked.declare, moving)
    ages = found_ages(base, moving)
    return (base if ages is None else kept_ages(base, ages, voting=True)), ages


def start_state(setup: Setup, terms: tuple[Term, ...]) -> ArrayState:
    """Fitted with the drawing and plain noise as the start."""
    one = np.ones(setup.triads)
    noise = SensorNoise(0.2, 0.0, np.inf, one), SensorNoise(5e-3, 0.0, np.inf, one)
    rate = np.median(setup.readings.rate, axis=1)
    ones = np.ones(setup.readings.rate.shape[:2])
    weights = Weights(ones / noise[0].sigma ** 2, ones / noise[1].sigma ** 2)
    sampled = fit_samples(setup.readings, weights, setup.board.drawn, rate)
    drawn = ArrayState(
        setup=setup,
        r=setup.board.drawn,
        terms=terms,
        noise=noise,
        sampled=sampled,
        motion=motion_at(setup, sampled, None),
        covariance=np.empty((0, 0)),
        density=-np.inf,
        converged=False,
    )
    return settled(drawn)
